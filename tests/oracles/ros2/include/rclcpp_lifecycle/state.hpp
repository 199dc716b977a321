#pragma once
#include <cstdint>
#include <string>
#include <utility>
namespace rclcpp_lifecycle
{
class State
{
public:
  State() = default;
  State(uint8_t id, const std::string & label)
  : id_(id), label_(label) {}
  State(const State & rhs) = default;
  virtual ~State() = default;
  State & operator=(const State & rhs) = default;
  uint8_t id() const {return id_;}
  std::string label() const {return label_;}

private:
  uint8_t id_ = 0;
  std::string label_;
};
}  // namespace rclcpp_lifecycle
