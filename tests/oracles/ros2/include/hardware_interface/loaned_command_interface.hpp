#pragma once
#include <functional>
#include <thread>
#include <utility>
#include "hardware_interface/handle.hpp"
namespace hardware_interface
{
class LoanedCommandInterface
{
public:
  using Deleter = std::function<void(void)>;
  explicit LoanedCommandInterface(CommandInterface::SharedPtr command_interface, Deleter && deleter)
  : command_interface_(*command_interface), deleter_(std::forward<Deleter>(deleter)) {}
  LoanedCommandInterface(const LoanedCommandInterface & other) = delete;
  LoanedCommandInterface(LoanedCommandInterface && other) = default;
  virtual ~LoanedCommandInterface()
  {
    if (deleter_) {
      deleter_();
    }
  }
  const std::string & get_name() const {return command_interface_.get_name();}
  const std::string & get_interface_name() const {return command_interface_.get_interface_name();}
  const std::string & get_prefix_name() const {return command_interface_.get_prefix_name();}

  template<typename T>
  [[nodiscard]] bool set_value(const T & value, unsigned int max_tries = 10)
  {
    for (unsigned int tries = 0; tries < max_tries; tries++) {
      if (command_interface_.set_value(value)) {
        return true;
      }
      std::this_thread::yield();
    }
    return false;
  }

  template<typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int max_tries = 10) const
  {
    for (unsigned int tries = 0; tries < max_tries; tries++) {
      const std::optional<T> value = command_interface_.get_optional<T>();
      if (value.has_value()) {
        return value;
      }
      std::this_thread::yield();
    }
    return std::nullopt;
  }

protected:
  CommandInterface & command_interface_;
  Deleter deleter_;
};
}  // namespace hardware_interface
