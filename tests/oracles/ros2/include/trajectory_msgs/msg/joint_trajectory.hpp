#pragma once
#include <memory>
#include <string>
#include <vector>
#include "std_msgs/msg/header.hpp"
namespace trajectory_msgs::msg
{
struct JointTrajectoryPoint
{
  std::vector<double> positions;
  std::vector<double> velocities;
  std::vector<double> accelerations;
  std::vector<double> effort;
  builtin_interfaces::msg::Duration time_from_start;
};
struct JointTrajectory
{
  using SharedPtr = std::shared_ptr<JointTrajectory>;
  using ConstSharedPtr = std::shared_ptr<JointTrajectory const>;
  std_msgs::msg::Header header;
  std::vector<std::string> joint_names;
  std::vector<JointTrajectoryPoint> points;
};
}  // namespace trajectory_msgs::msg
