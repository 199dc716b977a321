/* $made
 *
$about
 */
#ifndef ${NAME}_CONTROLLER_HPP_
#define ${NAME}_CONTROLLER_HPP_

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "realtime_tools/realtime_buffer.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

#include "$name.h"

namespace ${name}_plugin
{

constexpr std::size_t JOINTS = ${NAME}_JOINTS;
constexpr std::size_t ROWS = $rows;  /* commands of each joint */

/* Position, velocity, acceleration of one joint, joint side [rad, rad/s, rad/s^2]. */
using Motion = std::array<double, 3>;
using Motions = std::array<Motion, JOINTS>;

/* What was received, checked, with the joints in the order of the law; times in nanoseconds. */
struct Trajectory
{
  std::uint64_t number = 0;
  std::int64_t start = 0;  /* 0: when it is seen */
  std::vector<std::int64_t> times;
  std::vector<Motions> points;
};

class Controller : public controller_interface::ChainableControllerInterface
{
public:
  controller_interface::CallbackReturn on_init() override;

  controller_interface::InterfaceConfiguration command_interface_configuration() const override;

  controller_interface::InterfaceConfiguration state_interface_configuration() const override;

  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State & previous_state) override;

  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State & previous_state) override;

  controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous_state) override;

  controller_interface::CallbackReturn on_cleanup(const rclcpp_lifecycle::State & previous_state) override;

protected:
  std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;

  std::vector<hardware_interface::StateInterface> on_export_state_interfaces() override;

  bool on_set_chained_mode(bool chained_mode) override;

  controller_interface::return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

  controller_interface::return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  using Message = trajectory_msgs::msg::JointTrajectory;

  /* Why the parameters cannot be used; empty if they can. */
  std::string refused() const;

  /* Take a message; why it cannot be, empty if it can. Not in the real-time thread. */
  std::string take(const Message & message);

  /* Encoder counts of the state interfaces; NAN for one that is missing. */
  void measure(std::array<double, JOINTS> & counts) const;

  Motions along(const Trajectory & trajectory, std::int64_t now) const;

  /* Write the commands, row by row; false if an interface does not take one. */
  bool write(const double * values);

  /* Whether the hardware lends all interfaces of commands. */
  bool commands_found();

  std::vector<std::string> joints_;
  std::string state_interface_, unit_, topic_;
  std::vector<std::string> commands_;
  std::array<std::size_t, JOINTS> state_at_{};
  std::array<std::size_t, ROWS * JOINTS> command_at_{};
  rclcpp::Subscription<Message>::SharedPtr subscription_;
  realtime_tools::RealtimeBuffer<std::shared_ptr<const Trajectory>> received_;
  std::uint64_t received_count_ = 0;  /* of the subscription's thread */
  std::atomic<std::int64_t> seen_{0};  /* time of the last update [ns], which that thread reads */

  ${name}_state law_{};
  Motions reference_{}, from_{};  /* given last; where the trajectory was joined */
  std::uint64_t followed_ = 0;
  std::int64_t start_ = 0, since_ = 0;  /* of the trajectory; when it was joined, in its time [ns] */
  double now_ = 0.0;  /* [s], the sum of the periods */
  bool begun_ = false;
  int unwritten_ = 0;
};

}  // namespace ${name}_plugin

#endif  // ${NAME}_CONTROLLER_HPP_
