/* Of controller_interface 4 (Jazzy): every virtual; what a controller manager does with it as far as a controller sees. */
#pragma once
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>
#include "hardware_interface/handle.hpp"
#include "hardware_interface/loaned_command_interface.hpp"
#include "hardware_interface/loaned_state_interface.hpp"
#include "lifecycle_msgs/msg/state.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"
namespace controller_interface
{
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

enum class return_type : std::uint8_t
{
  OK = 0,
  ERROR = 1,
};

enum class interface_configuration_type : std::uint8_t
{
  ALL = 0,
  INDIVIDUAL = 1,
  NONE = 2,
};

struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names = {};
};

class ControllerInterfaceBase : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface
{
public:
  ControllerInterfaceBase() = default;
  virtual ~ControllerInterfaceBase() = default;

  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> && command_interfaces,
    std::vector<hardware_interface::LoanedStateInterface> && state_interfaces)
  {
    command_interfaces_ = std::move(command_interfaces);
    state_interfaces_ = std::move(state_interfaces);
  }
  virtual void release_interfaces()
  {
    command_interfaces_.clear();
    state_interfaces_.clear();
  }

  template<typename ParameterT>
  auto auto_declare(const std::string & name, const ParameterT & default_value)
  {
    if (!node_->has_parameter(name)) {
      return node_->declare_parameter<ParameterT>(name, default_value);
    } else {
      return node_->get_parameter(name).get_value<ParameterT>();
    }
  }

  return_type init(
    const std::string & controller_name, const std::string & urdf, unsigned int cm_update_rate,
    const std::string & node_namespace, const rclcpp::NodeOptions & node_options)
  {
    urdf_ = urdf;
    update_rate_ = cm_update_rate;
    node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>(controller_name, node_namespace, node_options, false);
    auto_declare<int>("update_rate", static_cast<int>(cm_update_rate));
    node_->register_on_configure([this](const auto & before) {return on_configure(before);});
    node_->register_on_cleanup([this](const auto & before) {return on_cleanup(before);});
    node_->register_on_activate([this](const auto & before) {return on_activate(before);});
    node_->register_on_deactivate([this](const auto & before) {return on_deactivate(before);});
    node_->register_on_shutdown([this](const auto & before) {return on_shutdown(before);});
    node_->register_on_error([this](const auto & before) {return on_error(before);});
    return on_init() == CallbackReturn::SUCCESS ? return_type::OK : return_type::ERROR;
  }

  const rclcpp_lifecycle::State & configure() {return node_->configure();}
  virtual CallbackReturn on_init() = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() {return node_;}
  std::shared_ptr<const rclcpp_lifecycle::LifecycleNode> get_node() const {return node_;}
  const rclcpp_lifecycle::State & get_lifecycle_state() const {return node_->get_current_state();}
  unsigned int get_update_rate() const {return update_rate_;}
  bool is_async() const {return false;}
  const std::string & get_robot_description() const {return urdf_;}

  virtual rclcpp::NodeOptions define_custom_node_options() const {return rclcpp::NodeOptions();}

  virtual bool is_chainable() const = 0;
  virtual std::vector<hardware_interface::CommandInterface::SharedPtr> export_reference_interfaces() = 0;
  virtual std::vector<hardware_interface::StateInterface::ConstSharedPtr> export_state_interfaces() = 0;
  virtual bool set_chained_mode(bool chained_mode) = 0;
  virtual bool is_in_chained_mode() const = 0;

protected:
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_;
  unsigned int update_rate_ = 0;
  std::string urdf_;
};
}  // namespace controller_interface
