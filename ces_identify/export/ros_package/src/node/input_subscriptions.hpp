// The node's subscriptions: one for each topic and type, with any number of signals.
//
// Types that are compiled in (model/message_types.hpp) arrive as messages, within a process without a copy. Any other
// installed type arrives as bytes and is deserialised into one message that is kept.
#ifndef NODE__INPUT_SUBSCRIPTIONS_HPP_
#define NODE__INPUT_SUBSCRIPTIONS_HPP_

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <rclcpp/node.hpp>
#include <rcpputils/shared_library.hpp>

#include "core/numbers.hpp"
#include "health/losses.hpp"
#include "node/field_reader.hpp"
#include "node/node_clock.hpp"

namespace ces
{

// Stamp, value [SI], frame id, the node's time on arrival.
using Deliver = std::function<void(Nanoseconds, double, const std::string &, Nanoseconds)>;
using OnError = std::function<void(const std::string &)>;

class InputSubscriptions
{
public:
  // Queues hold `depth` messages. `on_failure` is called with unexpected errors; no message throws out of a callback.
  InputSubscriptions(rclcpp::Node & node, const NodeClock & clock, std::size_t depth, OnError on_failure);
  ~InputSubscriptions();

  // Forget the delays of messages, as after a time jump.
  void reset();

  // Deliver each sample of `signal`, or the error that makes a message unreadable; return whether it is stamped. A
  // sample without a stamp is stamped with its arrival (ArrivalClock); the signal's delay is taken off the stamps.
  // Signals in one message are delivered in the order of their subscriptions. Raises UserError if topic, type or field
  // is wrong.
  bool subscribe(const SignalSettings & signal, Deliver deliver, OnError on_unreadable);

  // The losses on a subscribed signal's topic, as far as they are known.
  Losses & losses_of(const SignalSettings & signal);

private:
  class Topic;

  std::shared_ptr<Topic> find_topic(const SignalSettings & signal);
  void create_subscription(const SignalSettings & signal, const std::shared_ptr<Topic> & topic);

  rclcpp::Node & node_;
  const NodeClock & clock_;
  std::size_t depth_;
  OnError on_failure_;
  std::vector<std::shared_ptr<Topic>> topics_;
};

}  // namespace ces

#endif  // NODE__INPUT_SUBSCRIPTIONS_HPP_
