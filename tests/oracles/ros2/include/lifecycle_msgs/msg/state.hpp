#pragma once
#include <cstdint>
namespace lifecycle_msgs::msg
{
struct State
{
  static constexpr std::uint8_t PRIMARY_STATE_UNKNOWN = 0u;
  static constexpr std::uint8_t PRIMARY_STATE_UNCONFIGURED = 1u;
  static constexpr std::uint8_t PRIMARY_STATE_INACTIVE = 2u;
  static constexpr std::uint8_t PRIMARY_STATE_ACTIVE = 3u;
  static constexpr std::uint8_t PRIMARY_STATE_FINALIZED = 4u;
  static constexpr std::uint8_t TRANSITION_STATE_CONFIGURING = 10u;
  static constexpr std::uint8_t TRANSITION_STATE_CLEANINGUP = 11u;
  static constexpr std::uint8_t TRANSITION_STATE_SHUTTINGDOWN = 12u;
  static constexpr std::uint8_t TRANSITION_STATE_ACTIVATING = 13u;
  static constexpr std::uint8_t TRANSITION_STATE_DEACTIVATING = 14u;
  static constexpr std::uint8_t TRANSITION_STATE_ERRORPROCESSING = 15u;
};
}  // namespace lifecycle_msgs::msg
