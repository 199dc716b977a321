/* Its state machine: four primary states, a transition state while a callback runs, on_error where one fails badly. */
#pragma once
#include "lifecycle_msgs/msg/state.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/node_interfaces/lifecycle_node_interface.hpp"
#include "rclcpp_lifecycle/state.hpp"
namespace rclcpp_lifecycle
{
class LifecycleNode : public node_interfaces::LifecycleNodeInterface,
  public std::enable_shared_from_this<LifecycleNode>
{
public:
  using Callback = std::function<CallbackReturn(const State &)>;
  using Ids = lifecycle_msgs::msg::State;

  LifecycleNode(
    const std::string & node_name, const std::string & namespace_,
    const rclcpp::NodeOptions & options = rclcpp::NodeOptions(), bool enable_communication_interface = true)
  : name_(node_name), namespace_name_(namespace_), options_(options)
  {
    (void)enable_communication_interface;
  }
  virtual ~LifecycleNode() = default;

  const char * get_name() const {return name_.c_str();}
  const char * get_namespace() const {return namespace_name_.c_str();}
  rclcpp::Logger get_logger() const {return rclcpp::Logger();}

  template<
    typename MessageT, typename CallbackT, typename AllocatorT = std::allocator<void>,
    typename SubscriptionT = rclcpp::Subscription<MessageT>>
  std::shared_ptr<SubscriptionT> create_subscription(
    const std::string & topic_name, const rclcpp::QoS &, CallbackT && callback)
  {
    auto made = std::make_shared<SubscriptionT>();
    made->callback = std::forward<CallbackT>(callback);
    subscriptions[topic_name] = made;
    return made;
  }

  template<typename ParameterT>
  auto declare_parameter(const std::string & name, const ParameterT & default_value)
  {
    rclcpp::ParameterVariant value;
    if constexpr (std::is_same_v<ParameterT, int>) {
      value = static_cast<int64_t>(default_value);
    } else {
      value = default_value;
    }
    for (const auto & each : options_.parameter_overrides()) {
      if (each.first == name) {
        if (each.second.index() != value.index()) {
          throw std::runtime_error("parameter '" + name + "' has the wrong type");
        }
        value = each.second;
      }
    }
    parameters_[name] = rclcpp::Parameter(name, value);
    return parameters_[name].get_value<ParameterT>();
  }
  bool has_parameter(const std::string & name) const {return parameters_.count(name) > 0;}
  rclcpp::Parameter get_parameter(const std::string & name) const {return parameters_.at(name);}

  const State & get_current_state() const {return state_;}
  const State & configure() {return moved(Ids::PRIMARY_STATE_UNCONFIGURED, Ids::TRANSITION_STATE_CONFIGURING,
             Ids::PRIMARY_STATE_INACTIVE, configure_);}
  const State & cleanup() {return moved(Ids::PRIMARY_STATE_INACTIVE, Ids::TRANSITION_STATE_CLEANINGUP,
             Ids::PRIMARY_STATE_UNCONFIGURED, cleanup_);}
  const State & activate() {return moved(Ids::PRIMARY_STATE_INACTIVE, Ids::TRANSITION_STATE_ACTIVATING,
             Ids::PRIMARY_STATE_ACTIVE, activate_);}
  const State & deactivate() {return moved(Ids::PRIMARY_STATE_ACTIVE, Ids::TRANSITION_STATE_DEACTIVATING,
             Ids::PRIMARY_STATE_INACTIVE, deactivate_);}
  const State & shutdown() {return moved(state_.id(), Ids::TRANSITION_STATE_SHUTTINGDOWN,
             Ids::PRIMARY_STATE_FINALIZED, shutdown_);}

  bool register_on_configure(Callback fcn) {configure_ = std::move(fcn); return true;}
  bool register_on_cleanup(Callback fcn) {cleanup_ = std::move(fcn); return true;}
  bool register_on_activate(Callback fcn) {activate_ = std::move(fcn); return true;}
  bool register_on_deactivate(Callback fcn) {deactivate_ = std::move(fcn); return true;}
  bool register_on_shutdown(Callback fcn) {shutdown_ = std::move(fcn); return true;}
  bool register_on_error(Callback fcn) {error_ = std::move(fcn); return true;}

  std::map<std::string, std::shared_ptr<rclcpp::SubscriptionBase>> subscriptions;  /* of the stand-in */

private:
  const State & moved(uint8_t from, uint8_t during, uint8_t to, const Callback & callback)
  {
    if (state_.id() != from) {
      return state_;
    }
    const State before = state_;
    state_ = State(during, "transition");
    const CallbackReturn result = callback(before);
    if (result == CallbackReturn::SUCCESS) {
      state_ = State(to, "primary");
    } else if (result == CallbackReturn::FAILURE) {
      state_ = before;
    } else {
      state_ = State(Ids::TRANSITION_STATE_ERRORPROCESSING, "transition");
      const bool handled = error_(before) == CallbackReturn::SUCCESS;
      state_ = State(handled ? Ids::PRIMARY_STATE_UNCONFIGURED : Ids::PRIMARY_STATE_FINALIZED, "primary");
    }
    return state_;
  }

  std::string name_, namespace_name_;
  rclcpp::NodeOptions options_;
  std::map<std::string, rclcpp::Parameter> parameters_;
  State state_{Ids::PRIMARY_STATE_UNCONFIGURED, "unconfigured"};
  Callback configure_, cleanup_, activate_, deactivate_, shutdown_, error_;
};
}  // namespace rclcpp_lifecycle
