/* $made */
// Handles of values of one's own need a constructor that Jazzy says is deprecated, where it is inherited: in its header.
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"
#include "${name}_controller.hpp"

#include <math.h>

#include <algorithm>
#include <limits>
#include <optional>
#include <utility>

#include "hardware_interface/types/hardware_interface_type_values.hpp"
#include "lifecycle_msgs/msg/state.hpp"
#include "pluginlib/class_list_macros.hpp"

namespace ${name}_plugin
{
namespace
{

using controller_interface::CallbackReturn;
using controller_interface::return_type;

constexpr double NONE = std::numeric_limits<double>::quiet_NaN();
constexpr std::int64_t SECOND = 1000000000;
constexpr int UNWRITTEN = 3;  /* samples in a row for which the last torque may stand */
constexpr double AT_REST = 1e-6;  /* [rad/s], [rad/s^2], at the end of a trajectory */
const std::array<const char *, 3> PARTS = {
  hardware_interface::HW_IF_POSITION, hardware_interface::HW_IF_VELOCITY, hardware_interface::HW_IF_ACCELERATION};
const std::array<const char *, 3> STATES = {"stopped", "event", "brake"};

$functions
bool finite(const double * values, std::size_t count)
{
  return std::all_of(values, values + count, [](double value) {return std::isfinite(value);});
}

/* Where each wanted name stands among interfaces; false if one is not there. */
template<typename Loaned>
bool find(
  const std::vector<std::string> & joints, const std::string & interface, const std::vector<Loaned> & given,
  std::size_t * places)
{
  for (std::size_t i = 0; i < JOINTS; i++) {
    const std::string wanted = joints[i] + "/" + interface;
    places[i] = 0;
    while (places[i] < given.size() && given[places[i]].get_name() != wanted) {
      places[i]++;
    }
    if (places[i] == given.size()) {
      return false;
    }
  }
  return true;
}

}  // namespace

// -- lifecycle --------------------------------------------------------------------------------------------------------
CallbackReturn Controller::on_init()
{
  try {
    auto_declare<std::vector<std::string>>("joints", {$joints});
    auto_declare<std::string>("state_interface", hardware_interface::HW_IF_POSITION);
    auto_declare<$command_type>("$command_parameter", $commands);
    auto_declare<std::string>("unit", "rad");
    auto_declare<std::string>("topic", "~/joint_trajectory");
  } catch (const std::exception & error) {
    RCLCPP_ERROR(get_node()->get_logger(), "a parameter has another type than it must: %s", error.what());
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

std::string Controller::refused() const
{
  if (joints_.size() != JOINTS) {
    return "joints must have " + std::to_string(JOINTS) + " names; got " + std::to_string(joints_.size()) +
           ". Name those of the law, in its order.";
  }
  for (std::size_t i = 0; i < JOINTS; i++) {
    if (joints_[i].empty() || std::count(joints_.begin(), joints_.end(), joints_[i]) > 1) {
      return "joints must be different names; got '" + joints_[i] + "'. Name each once.";
    }
  }
  if (unit_ != "rad" && unit_ != "counts") {
    return "unit must be rad or counts; got '" + unit_ + "'. It is that of the state interfaces.";
  }
  const bool named = std::none_of(commands_.begin(), commands_.end(), [](const auto & name) {return name.empty();});
  if (state_interface_.empty() || !named || topic_.empty()) {
    return "state_interface, $command_parameter and topic must not be empty. Leave them out for their defaults.";
  }
  if (commands_.size() != ROWS) {
    return "$command_parameter must have " + std::to_string(ROWS) + " names; got " + std::to_string(commands_.size()) +
           ". Name the interface of each field.";
  }
  const double rate = get_update_rate();
  if (rate > 0.0 && std::abs(rate * ${NAME}_PERIOD - 1.0) > 1e-3) {
    return "update_rate must be " + std::to_string(1.0 / ${NAME}_PERIOD) + " Hz within 0.1 %; got " +
           std::to_string(rate) + ". Set it, or export a law of that period.";
  }
  return "";
}

CallbackReturn Controller::on_configure(const rclcpp_lifecycle::State & /*previous_state*/)
{
  joints_ = get_node()->get_parameter("joints").as_string_array();
  state_interface_ = get_node()->get_parameter("state_interface").as_string();
  commands_ = $commands_of_parameter;
  unit_ = get_node()->get_parameter("unit").as_string();
  topic_ = get_node()->get_parameter("topic").as_string();
  const std::string reason = refused();
  if (!reason.empty()) {
    RCLCPP_ERROR(get_node()->get_logger(), "%s", reason.c_str());
    return CallbackReturn::FAILURE;
  }
  subscription_ = get_node()->create_subscription<Message>(
    topic_, rclcpp::SystemDefaultsQoS(), [this](const std::shared_ptr<const Message> message) {
      const std::string why = take(*message);
      if (!why.empty()) {
        RCLCPP_ERROR(get_node()->get_logger(), "trajectory not taken: %s", why.c_str());
      }
    });
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_activate(const rclcpp_lifecycle::State & /*previous_state*/)
{
  if (
    !find(joints_, state_interface_, state_interfaces_, state_at_.data()) || !commands_found())
  {
    RCLCPP_ERROR(get_node()->get_logger(), "an interface of a joint is missing. Check the hardware's description.");
    return CallbackReturn::FAILURE;
  }
  std::array<double, JOINTS> counts{}, angles{};
  std::array<std::int32_t, JOINTS> pulses{};
  measure(counts);
  for (std::size_t i = 0; i < JOINTS; i++) {
    if (!(std::abs(counts[i]) < 2147483648.0) || counts[i] != std::floor(counts[i])) {
      RCLCPP_ERROR(
        get_node()->get_logger(), "%s must have whole counts to begin with; got %g. Check unit and driver.",
        joints_[i].c_str(), counts[i]);
      return CallbackReturn::FAILURE;
    }
    pulses[i] = static_cast<std::int32_t>(counts[i]);
  }
  angles_of(counts.data(), angles.data());
  for (std::size_t i = 0; i < JOINTS; i++) {
    reference_[i] = {angles[i], 0.0, 0.0};
  }
  from_ = reference_;
  ${name}_init(&law_, pulses.data());
  received_.initRT(nullptr);
  std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), NONE);
  std::fill(state_interfaces_values_.begin(), state_interfaces_values_.end(), 0.0);
  now_ = 0.0;
  begun_ = false;
  unwritten_ = 0;
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_deactivate(const rclcpp_lifecycle::State & /*previous_state*/)
{
$deactivated
}

CallbackReturn Controller::on_cleanup(const rclcpp_lifecycle::State & /*previous_state*/)
{
  subscription_.reset();
  return CallbackReturn::SUCCESS;
}

// -- interfaces -------------------------------------------------------------------------------------------------------
controller_interface::InterfaceConfiguration Controller::command_interface_configuration() const
{
  controller_interface::InterfaceConfiguration wanted{
    controller_interface::interface_configuration_type::INDIVIDUAL, {}};
  for (const std::string & command : commands_) {
    for (const std::string & joint : joints_) {
      wanted.names.push_back(joint + "/" + command);
    }
  }
  return wanted;
}

controller_interface::InterfaceConfiguration Controller::state_interface_configuration() const
{
  controller_interface::InterfaceConfiguration wanted{
    controller_interface::interface_configuration_type::INDIVIDUAL, {}};
  for (const std::string & joint : joints_) {
    wanted.names.push_back(joint + "/" + state_interface_);
  }
  return wanted;
}

std::vector<hardware_interface::CommandInterface> Controller::on_export_reference_interfaces()
{
  reference_interfaces_.assign(PARTS.size() * JOINTS, NONE);
  std::vector<hardware_interface::CommandInterface> exported;
  exported.reserve(reference_interfaces_.size());
  for (std::size_t part = 0; part < PARTS.size(); part++) {
    for (std::size_t i = 0; i < JOINTS; i++) {
      exported.emplace_back(
        std::string(get_node()->get_name()) + "/" + joints_[i], PARTS[part],
        &reference_interfaces_[part * JOINTS + i]);
    }
  }
  return exported;
}

std::vector<hardware_interface::StateInterface> Controller::on_export_state_interfaces()
{
  state_interfaces_values_.assign(STATES.size(), 0.0);
  std::vector<hardware_interface::StateInterface> exported;
  exported.reserve(STATES.size());
  for (std::size_t i = 0; i < STATES.size(); i++) {
    exported.emplace_back(get_node()->get_name(), STATES[i], &state_interfaces_values_[i]);
  }
  return exported;
}

bool Controller::on_set_chained_mode(bool /*chained_mode*/)
{
  std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), NONE);
  return true;
}

// -- the topic --------------------------------------------------------------------------------------------------------
std::string Controller::take(const Message & message)
{
  if (get_lifecycle_state().id() != lifecycle_msgs::msg::State::PRIMARY_STATE_ACTIVE) {
    return "the controller is not active. Activate it first.";
  }
  if (is_in_chained_mode()) {
    return "another controller gives the reference. Send it there.";
  }
  std::array<std::size_t, JOINTS> place{};
  for (std::size_t i = 0; i < JOINTS; i++) {
    const auto & names = message.joint_names;
    const auto found = std::find(names.begin(), names.end(), joints_[i]);
    if (found == names.end() || names.size() != JOINTS) {
      return "joint_names must be those of the controller, in any order; check " + joints_[i] + ".";
    }
    place[i] = static_cast<std::size_t>(found - names.begin());
  }
  auto taken = std::make_shared<Trajectory>();
  taken->start = message.header.stamp.sec * SECOND + message.header.stamp.nanosec;
  for (const auto & point : message.points) {
    const std::string which = "point " + std::to_string(taken->points.size());
    if (
      point.positions.size() != JOINTS || point.velocities.size() != JOINTS ||
      point.accelerations.size() != JOINTS || !point.effort.empty())
    {
      return which + " must have a position, a velocity and an acceleration per joint, and no effort. Plan it so.";
    }
    Motions motions{};
    for (std::size_t i = 0; i < JOINTS; i++) {
      motions[i] = {point.positions[place[i]], point.velocities[place[i]], point.accelerations[place[i]]};
      if (!finite(motions[i].data(), motions[i].size())) {
        return which + " must be finite; " + joints_[i] + " is not. Plan it anew.";
      }
    }
    const std::int64_t at = point.time_from_start.sec * SECOND + point.time_from_start.nanosec;
    if (at < 0 || (!taken->times.empty() && at <= taken->times.back())) {
      return which + " must come after the one before it, none before the start. Order the points.";
    }
    taken->times.push_back(at);
    taken->points.push_back(motions);
  }
  if (taken->points.empty()) {
    return "it has no points. Deactivate the controller to stop it.";
  }
  if (taken->start > 0 && taken->start + taken->times.back() <= seen_.load()) {
    return "it ended before it came. Send it with a later stamp, or with one of zero.";
  }
  for (const Motion & last : taken->points.back()) {
    if (std::abs(last[1]) > AT_REST || std::abs(last[2]) > AT_REST) {
      return "it must end at rest. End it with zero velocities and accelerations.";
    }
  }
  taken->number = ++received_count_;
  received_.writeFromNonRT(taken);
  return "";
}

// -- in the real-time thread: nothing below allocates -----------------------------------------------------------------
void Controller::measure(std::array<double, JOINTS> & counts) const
{
  std::array<double, JOINTS> positions{};
  for (std::size_t i = 0; i < JOINTS; i++) {
    positions[i] = state_interfaces_[state_at_[i]].get_optional().value_or(NONE);
  }
  if (unit_ == "rad") {
    counts_of(positions.data(), counts.data());
  } else {
    counts = positions;
  }
}

Motions Controller::along(const Trajectory & trajectory, std::int64_t now) const
{
  const auto next = std::upper_bound(trajectory.times.begin(), trajectory.times.end(), now);
  const auto place = static_cast<std::size_t>(next - trajectory.times.begin());
  Motions motions = trajectory.points.back();
  if (next == trajectory.times.end()) {
    for (Motion & motion : motions) {
      motion[1] = motion[2] = 0.0;
    }
    return motions;
  }
  const bool joins = place == 0 || trajectory.times[place - 1] < since_;
  const Motions & begun = joins ? from_ : trajectory.points[place - 1];
  const std::int64_t since = joins ? since_ : trajectory.times[place - 1];
  const double span = static_cast<double>(*next - since) / static_cast<double>(SECOND);
  const double at = static_cast<double>(now - since) / static_cast<double>(SECOND);
  for (std::size_t i = 0; i < JOINTS; i++) {
    between(begun[i].data(), trajectory.points[place][i].data(), span, at, motions[i].data());
  }
  return motions;
}

return_type Controller::update_reference_from_subscribers(
  const rclcpp::Time & time, const rclcpp::Duration & /*period*/)
{
  seen_.store(time.nanoseconds());
  const std::shared_ptr<const Trajectory> & given = *received_.readFromRT();
  if (given && given->number != followed_) {
    followed_ = given->number;
    from_ = reference_;
    start_ = given->start > 0 ? given->start : time.nanoseconds();
    const auto moves = [](const Motion & motion) {return motion[1] != 0.0 || motion[2] != 0.0;};
    const bool moving = std::any_of(from_.begin(), from_.end(), moves);
    const std::int64_t now = time.nanoseconds() - start_;
    since_ = moving ? now : std::max<std::int64_t>(now, 0);  // at rest it waits for the start
  }
  if (given && time.nanoseconds() >= start_ + since_) {
    reference_ = along(*given, time.nanoseconds() - start_);
  }
  for (std::size_t i = 0; i < JOINTS; i++) {
    for (std::size_t part = 0; part < PARTS.size(); part++) {
      reference_interfaces_[part * JOINTS + i] = reference_[i][part];
    }
  }
  return return_type::OK;
}

return_type Controller::update_and_write_commands(const rclcpp::Time & /*time*/, const rclcpp::Duration & period)
{
  std::array<double, JOINTS> counts{};
  std::array<$type, ROWS * JOINTS> $output{};
  now_ += period.seconds();
  measure(counts);
  if (!begun_ && !finite(reference_interfaces_.data(), reference_interfaces_.size())) {
    for (std::size_t i = 0; i < JOINTS; i++) {  // nobody gives a reference yet: where it began
      for (std::size_t part = 0; part < PARTS.size(); part++) {
        reference_interfaces_[part * JOINTS + i] = reference_[i][part];
      }
    }
  } else {
    begun_ = true;
  }
  const double * q = reference_interfaces_.data();
  const int refusal =
    ${name}_sample(&law_, counts.data(), q, q + JOINTS, q + 2 * JOINTS, now_, $output.data());
  if (!begun_) {
    std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), NONE);
  }
  int joint = 0;
  long call = 0;
  state_interfaces_values_[0] = ${name}_stopped(&law_);
  state_interfaces_values_[1] = ${name}_event(&law_, &joint, &call);
  state_interfaces_values_[2] = ${name}_brake(&law_);
$written
  return refusal != 0 || unwritten_ > UNWRITTEN ? return_type::ERROR : return_type::OK;
}

bool Controller::write(const double * values)
{
  bool written = true;
  for (std::size_t i = 0; i < command_at_.size(); i++) {
    written = command_interfaces_[command_at_[i]].set_value(values[i]) && written;
  }
  return written;
}

bool Controller::commands_found()
{
  for (std::size_t row = 0; row < ROWS; row++) {
    if (!find(joints_, commands_[row], command_interfaces_, &command_at_[row * JOINTS])) {
      return false;
    }
  }
  return true;
}

}  // namespace ${name}_plugin

PLUGINLIB_EXPORT_CLASS(${name}_plugin::Controller, controller_interface::ChainableControllerInterface)
