/* Of rclcpp (Jazzy, 28), what a controller meets; parameters, topics and logs are kept in memory. */
#pragma once
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>
namespace rclcpp
{
class Duration
{
public:
  explicit Duration(int64_t nanoseconds_ns)
  : nanoseconds_(nanoseconds_ns) {}
  int64_t nanoseconds() const {return nanoseconds_;}
  double seconds() const {return static_cast<double>(nanoseconds_) / 1e9;}

private:
  int64_t nanoseconds_;
};

class Time
{
public:
  explicit Time(int64_t nanoseconds = 0)
  : nanoseconds_(nanoseconds) {}
  int64_t nanoseconds() const {return nanoseconds_;}
  double seconds() const {return static_cast<double>(nanoseconds_) / 1e9;}

private:
  int64_t nanoseconds_;
};

class Logger
{
public:
  const char * get_name() const {return "stand-in";}
};

inline std::string & last_log()
{
  static std::string text;
  return text;
}

using ParameterVariant = std::variant<std::monostate, bool, int64_t, double, std::string, std::vector<std::string>>;

class Parameter
{
public:
  Parameter() = default;
  Parameter(std::string name, ParameterVariant value)
  : name_(std::move(name)), value_(std::move(value)) {}
  bool as_bool() const {return std::get<bool>(value_);}
  int64_t as_int() const {return std::get<int64_t>(value_);}
  double as_double() const {return std::get<double>(value_);}
  const std::string & as_string() const {return std::get<std::string>(value_);}
  const std::vector<std::string> & as_string_array() const {return std::get<std::vector<std::string>>(value_);}
  template<typename T>
  T get_value() const
  {
    if constexpr (std::is_same_v<T, int>) {
      return static_cast<int>(as_int());
    } else {
      return std::get<T>(value_);
    }
  }

private:
  std::string name_;
  ParameterVariant value_;
};

class NodeOptions
{
public:
  NodeOptions & parameter_overrides(const std::vector<std::pair<std::string, ParameterVariant>> & given)
  {
    overrides_ = given;
    return *this;
  }
  const std::vector<std::pair<std::string, ParameterVariant>> & parameter_overrides() const {return overrides_;}
  NodeOptions & enable_logger_service(bool) {return *this;}

private:
  std::vector<std::pair<std::string, ParameterVariant>> overrides_;
};

class QoS
{
public:
  explicit QoS(std::size_t) {}
};
class SystemDefaultsQoS : public QoS
{
public:
  SystemDefaultsQoS()
  : QoS(10) {}
};

class SubscriptionBase
{
public:
  virtual ~SubscriptionBase() = default;
};
template<typename MessageT>
class Subscription : public SubscriptionBase
{
public:
  using SharedPtr = std::shared_ptr<Subscription<MessageT>>;
  std::function<void(std::shared_ptr<const MessageT>)> callback;
};
}  // namespace rclcpp

#define STAND_IN_LOG(logger, ...) \
  do { \
    (void)(logger); \
    char stand_in_text[512]; \
    std::snprintf(stand_in_text, sizeof stand_in_text, __VA_ARGS__); \
    rclcpp::last_log() = stand_in_text; \
  } while (0)
#define RCLCPP_ERROR(logger, ...) STAND_IN_LOG(logger, __VA_ARGS__)
#define RCLCPP_WARN(logger, ...) STAND_IN_LOG(logger, __VA_ARGS__)
#define RCLCPP_INFO(logger, ...) STAND_IN_LOG(logger, __VA_ARGS__)
