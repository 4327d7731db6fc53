// The node as a component of rclcpp_components, ces_observer_cpp::Observer.

#include <rclcpp_components/register_node_macro.hpp>

#include "node/observer_node.hpp"

namespace ces_observer_cpp
{

class Observer : public ces::ObserverNode
{
public:
  explicit Observer(const rclcpp::NodeOptions & options)
  : ObserverNode(options) {}
};

}  // namespace ces_observer_cpp

RCLCPP_COMPONENTS_REGISTER_NODE(ces_observer_cpp::Observer)
