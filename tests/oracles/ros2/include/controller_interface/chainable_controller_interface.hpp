/* Of controller_interface 4 (Jazzy). */
#pragma once
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>
#include "controller_interface/controller_interface_base.hpp"
namespace controller_interface
{
class ChainableControllerInterface : public ControllerInterfaceBase
{
public:
  ChainableControllerInterface() = default;
  virtual ~ChainableControllerInterface() = default;

  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) final
  {
    if (!is_in_chained_mode()) {
      const return_type result = update_reference_from_subscribers(time, period);
      if (result != return_type::OK) {
        return result;
      }
    }
    return update_and_write_commands(time, period);
  }
  bool is_chainable() const final {return true;}

  std::vector<hardware_interface::StateInterface::ConstSharedPtr> export_state_interfaces() final
  {
    std::vector<hardware_interface::StateInterface::ConstSharedPtr> shared;
    for (auto & each : on_export_state_interfaces()) {
      require_prefix(each.get_prefix_name());
      shared.push_back(std::make_shared<hardware_interface::StateInterface>(each));
    }
    require_size(state_interfaces_values_.size(), shared.size());
    return shared;
  }

  std::vector<hardware_interface::CommandInterface::SharedPtr> export_reference_interfaces() final
  {
    std::vector<hardware_interface::CommandInterface::SharedPtr> shared;
    for (auto & each : on_export_reference_interfaces()) {
      require_prefix(each.get_prefix_name());
      shared.push_back(std::make_shared<hardware_interface::CommandInterface>(std::move(each)));
    }
    require_size(reference_interfaces_.size(), shared.size());
    return shared;
  }

  bool set_chained_mode(bool chained_mode) final
  {
    if (get_lifecycle_state().id() == lifecycle_msgs::msg::State::PRIMARY_STATE_ACTIVE) {
      return false;
    }
    const bool switched = on_set_chained_mode(chained_mode);
    in_chained_mode_ = switched ? chained_mode : in_chained_mode_;
    return switched;
  }
  bool is_in_chained_mode() const final {return in_chained_mode_;}

protected:
  virtual std::vector<hardware_interface::StateInterface> on_export_state_interfaces() {return {};}
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() {return {};}
  virtual bool on_set_chained_mode(bool chained_mode)
  {
    (void)chained_mode;
    return true;
  }
  virtual return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
  virtual return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  std::vector<std::string> exported_state_interface_names_;
  std::vector<hardware_interface::StateInterface::SharedPtr> ordered_exported_state_interfaces_;
  std::unordered_map<std::string, hardware_interface::StateInterface::SharedPtr> exported_state_interfaces_;
  std::vector<double> state_interfaces_values_;
  std::vector<std::string> exported_reference_interface_names_;
  std::vector<double> reference_interfaces_;
  std::vector<hardware_interface::CommandInterface::SharedPtr> ordered_exported_reference_interfaces_;
  std::unordered_map<std::string, hardware_interface::CommandInterface::SharedPtr> exported_reference_interfaces_;

private:
  void require_prefix(const std::string & prefix) const
  {
    if (prefix.find(get_node()->get_name()) != 0) {
      throw std::runtime_error("the prefix of an interface must begin with the controller's name: " + prefix);
    }
  }
  static void require_size(std::size_t values, std::size_t interfaces)
  {
    if (values != interfaces) {
      throw std::runtime_error("there must be one value per exported interface");
    }
  }

  bool in_chained_mode_ = false;
};
}  // namespace controller_interface
