#pragma once
#include <functional>
#include <thread>
#include <utility>
#include "hardware_interface/handle.hpp"
namespace hardware_interface
{
class LoanedStateInterface
{
public:
  using Deleter = std::function<void(void)>;
  explicit LoanedStateInterface(StateInterface::ConstSharedPtr state_interface)
  : LoanedStateInterface(state_interface, nullptr) {}
  LoanedStateInterface(StateInterface::ConstSharedPtr state_interface, Deleter && deleter)
  : state_interface_(*state_interface), deleter_(std::forward<Deleter>(deleter)) {}
  LoanedStateInterface(const LoanedStateInterface & other) = delete;
  LoanedStateInterface(LoanedStateInterface && other) = default;
  virtual ~LoanedStateInterface()
  {
    if (deleter_) {
      deleter_();
    }
  }
  const std::string & get_name() const {return state_interface_.get_name();}
  const std::string & get_interface_name() const {return state_interface_.get_interface_name();}
  const std::string & get_prefix_name() const {return state_interface_.get_prefix_name();}

  template<typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int max_tries = 10) const
  {
    for (unsigned int tries = 0; tries < max_tries; tries++) {
      const std::optional<T> value = state_interface_.get_optional<T>();
      if (value.has_value()) {
        return value;
      }
      std::this_thread::yield();
    }
    return std::nullopt;
  }

protected:
  const StateInterface & state_interface_;
  Deleter deleter_;
};
}  // namespace hardware_interface
