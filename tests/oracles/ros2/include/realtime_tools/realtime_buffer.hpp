/* Two copies: the one that the real-time thread reads, and the one that is written; swapped where nobody waits. */
#pragma once
#include <mutex>
#include <utility>
namespace realtime_tools
{
using prio_inherit_mutex = std::mutex;
template<class T, class MutexType = prio_inherit_mutex>
class RealtimeBuffer
{
public:
  RealtimeBuffer() = default;
  explicit RealtimeBuffer(const T & data)
  : realtime_(data), other_(data) {}
  T * readFromRT()
  {
    std::unique_lock<MutexType> guard(mutex_, std::try_to_lock);
    if (guard.owns_lock() && new_) {
      std::swap(reading_, writing_);
      new_ = false;
    }
    return reading_;
  }
  T * readFromNonRT() const
  {
    std::lock_guard<MutexType> guard(mutex_);
    return new_ ? writing_ : reading_;
  }
  void writeFromNonRT(const T & data)
  {
    std::lock_guard<MutexType> guard(mutex_);
    *writing_ = data;
    new_ = true;
  }
  void initRT(const T & data)
  {
    *reading_ = data;
    *writing_ = data;
  }

private:
  T realtime_{}, other_{};
  T * reading_ = &realtime_;
  T * writing_ = &other_;
  bool new_ = false;
  mutable MutexType mutex_;
};
}  // namespace realtime_tools
