/* A controller manager of one controller, for tests that call it through C: hardware, clock, topic, and a count of
 * allocations while `update` runs. */
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <new>
#include <thread>

#include "controller_interface/chainable_controller_interface.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

static std::atomic<bool> counting{false};
static std::atomic<long> allocated{0};

static void * counted(std::size_t size)
{
  allocated += counting ? 1 : 0;
  void * const given = std::malloc(size);
  if (given == nullptr) {
    throw std::bad_alloc();
  }
  return given;
}
void * operator new(std::size_t size) {return counted(size);}
void * operator new[](std::size_t size) {return counted(size);}
static void counted_free(void * given) noexcept
{
  allocated += counting ? 1 : 0;
  std::free(given);
}
void operator delete(void * given) noexcept {counted_free(given);}
void operator delete(void * given, std::size_t) noexcept {counted_free(given);}
void operator delete[](void * given) noexcept {counted_free(given);}
void operator delete[](void * given, std::size_t) noexcept {counted_free(given);}

namespace
{
using Message = trajectory_msgs::msg::JointTrajectory;
using Base = controller_interface::ChainableControllerInterface;

/* Another thread that holds the lock of a value, as hardware does that runs beside. */
struct Busy : hardware_interface::CommandInterface
{
  using CommandInterface::CommandInterface;
  void hold(bool held)
  {
    if (held) {
      std::atomic<bool> taken{false};
      holder = std::thread([this, &taken] {
            handle_mutex_.lock();
            taken = true;
            while (!release) {
              std::this_thread::yield();
            }
            handle_mutex_.unlock();
          });
      while (!taken) {
        std::this_thread::yield();
      }
    } else {
      release = true;
      holder.join();
      release = false;
    }
  }
  std::thread holder;
  std::atomic<bool> release{false};
};

std::shared_ptr<Base> controller;
std::vector<double> positions, efforts;
std::vector<std::shared_ptr<Busy>> commands;
std::vector<hardware_interface::CommandInterface::SharedPtr> references;
std::vector<hardware_interface::StateInterface::ConstSharedPtr> states;
std::vector<std::pair<std::string, rclcpp::ParameterVariant>> overrides;

int failed(const std::exception & error)
{
  rclcpp::last_log() = error.what();
  return -1;
}
}  // namespace

extern "C" {
void override_text(const char * name, const char * value) {overrides.emplace_back(name, std::string(value));}
void override_names(const char * name, const char * values)
{
  std::vector<std::string> split(1);
  for (; *values; values++) {
    if (*values == ',') {
      split.emplace_back();
    } else {
      split.back() += *values;
    }
  }
  overrides.emplace_back(name, split);
}
int load(const char * type, const char * name, unsigned int rate)
{
  rclcpp::last_log().clear();
  references.clear();
  states.clear();
  controller = pluginlib::classes<Base>().at(type)();
  const auto options = controller->define_custom_node_options().parameter_overrides(overrides);
  overrides.clear();
  return static_cast<int>(controller->init(name, "", rate, "", options));
}
int configure()
{
  try {
    if (controller->configure().id() == lifecycle_msgs::msg::State::PRIMARY_STATE_INACTIVE) {
      states = controller->export_state_interfaces();
      references = controller->export_reference_interfaces();
    }
    return controller->get_lifecycle_state().id();
  } catch (const std::exception & error) {
    return failed(error);
  }
}
int chain(int chained) {return controller->set_chained_mode(chained != 0);}

/* Interfaces in the reverse of the order in which they were asked for, at these positions. */
int activate(const double * begun)
{
  const auto read = controller->state_interface_configuration().names;
  const auto written = controller->command_interface_configuration().names;
  positions.assign(begun, begun + read.size());
  efforts.assign(written.size(), 0.0);
  commands.clear();
  std::vector<hardware_interface::LoanedCommandInterface> lent;
  std::vector<hardware_interface::LoanedStateInterface> shown;
  static std::vector<std::shared_ptr<hardware_interface::StateInterface>> kept;
  kept.clear();
  for (std::size_t k = read.size(); k-- > 0; ) {
    const auto slash = read[k].rfind('/');
    kept.push_back(std::make_shared<hardware_interface::StateInterface>(
        read[k].substr(0, slash), read[k].substr(slash + 1), &positions[k]));
    shown.emplace_back(kept.back());
  }
  for (std::size_t k = written.size(); k-- > 0; ) {
    const auto slash = written[k].rfind('/');
    commands.push_back(std::make_shared<Busy>(
        written[k].substr(0, slash), written[k].substr(slash + 1), &efforts[k]));
    lent.emplace_back(commands.back(), nullptr);
  }
  controller->assign_interfaces(std::move(lent), std::move(shown));
  return controller->get_node()->activate().id();
}
int deactivate()
{
  const int state = controller->get_node()->deactivate().id();
  controller->release_interfaces();
  return state;
}
int cleanup() {return controller->get_node()->cleanup().id();}
int shut_down() {return controller->get_node()->shutdown().id();}
int give_reference(const double * values)
{
  for (std::size_t i = 0; i < references.size(); i++) {
    if (!references[i]->set_value(values[i])) {
      return 1;
    }
  }
  return 0;
}
int reference_count() {return static_cast<int>(references.size());}
const char * reference_name(int i) {return references[static_cast<std::size_t>(i)]->get_name().c_str();}
double state_value(int i) {return states[static_cast<std::size_t>(i)]->get_optional().value();}
void hold(int held) {commands.front()->hold(held != 0);}

/* One sample at a time and after a period [ns]. */
int update(long long now, long long period, const double * at, double * torque)
{
  std::copy(at, at + positions.size(), positions.begin());
  const rclcpp::Time time(now);
  const rclcpp::Duration since(period);
  counting = true;
  const auto result = controller->update(time, since);
  counting = false;
  std::copy(efforts.begin(), efforts.end(), torque);
  return static_cast<int>(result);
}
/* A message: stamp and times [ns], rows (points, 3, joints); without accelerations if `empty`. */
void send(
  const char * topic, const char * joints, int points, const long long * times, const double * rows, int empty,
  long long stamp)
{
  auto message = std::make_shared<Message>();
  message->header.stamp.sec = static_cast<std::int32_t>(stamp / 1000000000);
  message->header.stamp.nanosec = static_cast<std::uint32_t>(stamp % 1000000000);
  message->joint_names.emplace_back();
  for (; *joints; joints++) {
    if (*joints == ',') {
      message->joint_names.emplace_back();
    } else {
      message->joint_names.back() += *joints;
    }
  }
  const std::size_t n = message->joint_names.size();
  for (std::size_t k = 0; k < static_cast<std::size_t>(points); k++, rows += 3 * n) {
    trajectory_msgs::msg::JointTrajectoryPoint point;
    point.positions.assign(rows, rows + n);
    point.velocities.assign(rows + n, rows + 2 * n);
    if (!empty) {
      point.accelerations.assign(rows + 2 * n, rows + 3 * n);
    }
    point.time_from_start.sec = static_cast<std::int32_t>(times[k] / 1000000000);
    point.time_from_start.nanosec = static_cast<std::uint32_t>(times[k] % 1000000000);
    message->points.push_back(point);
  }
  const auto & given = controller->get_node()->subscriptions.at(topic);
  std::static_pointer_cast<rclcpp::Subscription<Message>>(given)->callback(message);
}
const char * said() {return rclcpp::last_log().c_str();}
long allocations() {return allocated;}
}
