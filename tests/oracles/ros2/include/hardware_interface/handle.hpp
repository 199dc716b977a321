/* Of hardware_interface 4 (Jazzy): constructors from a pointer are deprecated, values are read and written by try_lock. */
#pragma once
#include <memory>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>
namespace hardware_interface
{
class Handle
{
public:
  [[deprecated("Use InterfaceDescription for initializing the Interface")]]
  Handle(const std::string & prefix_name, const std::string & interface_name, double * value_ptr = nullptr)
  : prefix_name_(prefix_name), interface_name_(interface_name), handle_name_(prefix_name + "/" + interface_name),
    value_ptr_(value_ptr) {}
  Handle(const Handle & other) noexcept {copy(other);}
  Handle & operator=(const Handle & other) {copy(other); return *this;}
  Handle(Handle && other) noexcept {copy(other);}
  Handle & operator=(Handle && other) {copy(other); return *this;}
  virtual ~Handle() = default;

  inline operator bool() const {return value_ptr_ != nullptr;}
  const std::string & get_name() const {return handle_name_;}
  const std::string & get_interface_name() const {return interface_name_;}
  const std::string & get_prefix_name() const {return prefix_name_;}

  [[deprecated("Use std::optional<T> get_optional() instead to retrieve the value.")]]
  double get_value() const {return *value_ptr_;}

  template<typename T = double>
  [[nodiscard]] std::optional<T> get_optional() const
  {
    std::shared_lock<std::shared_mutex> lock(handle_mutex_, std::try_to_lock);
    return lock.owns_lock() ? std::optional<T>(*value_ptr_) : std::nullopt;
  }

  template<typename T>
  [[nodiscard]] bool set_value(const T & value)
  {
    std::unique_lock<std::shared_mutex> lock(handle_mutex_, std::try_to_lock);
    if (!lock.owns_lock()) {
      return false;
    }
    *value_ptr_ = value;
    return true;
  }

private:
  void copy(const Handle & other) noexcept
  {
    prefix_name_ = other.prefix_name_;
    interface_name_ = other.interface_name_;
    handle_name_ = other.handle_name_;
    value_ptr_ = other.value_ptr_;
  }

protected:
  std::string prefix_name_;
  std::string interface_name_;
  std::string handle_name_;
  double * value_ptr_;
  mutable std::shared_mutex handle_mutex_;
};

class StateInterface : public Handle
{
public:
  StateInterface(const StateInterface & other) = default;
  StateInterface(StateInterface && other) = default;
  using Handle::Handle;
  using SharedPtr = std::shared_ptr<StateInterface>;
  using ConstSharedPtr = std::shared_ptr<const StateInterface>;
};

class CommandInterface : public Handle
{
public:
  CommandInterface(const CommandInterface & other) = delete;
  CommandInterface(CommandInterface && other) = default;
  using Handle::Handle;
  using SharedPtr = std::shared_ptr<CommandInterface>;
};
}  // namespace hardware_interface
