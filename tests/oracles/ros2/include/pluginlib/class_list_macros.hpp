#pragma once
#include <functional>
#include <map>
#include <memory>
#include <string>
namespace pluginlib
{
template<typename Base>
std::map<std::string, std::function<std::shared_ptr<Base>()>> & classes()
{
  static std::map<std::string, std::function<std::shared_ptr<Base>()>> known;
  return known;
}
}  // namespace pluginlib
#define PLUGINLIB_EXPORT_CLASS(class_type, base_class_type) \
  static const bool stand_in_registered = \
    pluginlib::classes<base_class_type>().emplace(#class_type, [] {return std::make_shared<class_type>();}).second; \
  bool stand_in_is_registered() {return stand_in_registered;}
bool stand_in_is_registered();
