#pragma once
#include <cstdint>
namespace lifecycle_msgs::msg
{
struct Transition
{
  static constexpr std::uint8_t TRANSITION_CALLBACK_SUCCESS = 97u;
  static constexpr std::uint8_t TRANSITION_CALLBACK_FAILURE = 98u;
  static constexpr std::uint8_t TRANSITION_CALLBACK_ERROR = 99u;
};
}  // namespace lifecycle_msgs::msg
