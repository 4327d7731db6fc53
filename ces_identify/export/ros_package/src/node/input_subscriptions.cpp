#include "node/input_subscriptions.hpp"

#include <utility>

#include <rclcpp/generic_subscription.hpp>
#include <rclcpp/serialization.hpp>
#include <rclcpp/typesupport_helpers.hpp>

#include "core/arrival_clock.hpp"
#include "model/message_types.hpp"
#include "node/message_memory.hpp"
#include "node/user_error.hpp"

namespace ces
{

// One topic with the readers of its signals.
class InputSubscriptions::Topic
{
public:
  Topic(InputSubscriptions & inputs, const std::string & name, const SignalSettings & signal)
  : name(name), type(signal.type), losses(inputs.depth_), inputs_(inputs)
  {
    try {
      introspection_ = rclcpp::get_typesupport_library(type, "rosidl_typesupport_introspection_cpp");
      members_ = static_cast<const MessageMembers *>(
        rclcpp::get_message_typesupport_handle(type, "rosidl_typesupport_introspection_cpp", *introspection_)->data);
    } catch (const std::exception &) {
      throw UserError(
        "signal '" + signal.name + "': message type '" + type + "' is not installed; check " + signal.name +
        ".type, or source the workspace that has it");
    }
    header_ = find_header(*members_);
  }

  bool is_stamped() const {return header_.has_value();}

  const MessageMembers & members() const {return *members_;}

  void add(const SignalSettings & signal, Deliver deliver, OnError on_unreadable)
  {
    readers_.push_back(
      {FieldReader(signal, *members_), to_ns(signal.delay_s), std::move(deliver), std::move(on_unreadable)});
  }

  // Forget the delays of messages.
  void reset() {arrivals_.reset();}

  // Read a message; the callback of the subscription.
  void take(const void * message, const rmw_message_info_t & info)
  {
    try {
      const auto now = inputs_.clock_.now();
      take_number(info.publication_sequence_number);
      static const std::string NO_FRAME;
      const auto * header = header_ ? reinterpret_cast<const std_msgs::msg::Header *>(
        static_cast<const char *>(message) + *header_) : nullptr;
      const auto stamp = header ? header->stamp.sec * SECOND + header->stamp.nanosec : stamp_arrival(info, now);
      for (const auto & reader : readers_) {
        if (const auto value = reader.field.read(message, error_)) {
          reader.deliver(stamp - reader.delay, *value, header ? header->frame_id : NO_FRAME, now);
        } else {
          reader.on_unreadable(error_);
        }
      }
    } catch (const std::exception & error) {  // no message may stop the next ones
      inputs_.on_failure_(error.what());
    }
  }

  const std::string name, type;
  std::shared_ptr<rclcpp::SubscriptionBase> subscription;
  Losses losses;

private:
  struct Reader
  {
    FieldReader field;
    Nanoseconds delay;
    Deliver deliver;
    OnError on_unreadable;
  };

  void take_number(std::uint64_t number)
  {
    const bool has_number = number != RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED && number != 0;
    losses.take_number(has_number ? std::optional<std::uint64_t>(number) : std::nullopt);
  }

  // The arrival of a message without a stamp; simulated time does not show when it was sent.
  Nanoseconds stamp_arrival(const rmw_message_info_t & info, Nanoseconds now)
  {
    return inputs_.clock_.is_simulated() ? now : arrivals_.stamp(info.source_timestamp, now);
  }

  InputSubscriptions & inputs_;
  std::shared_ptr<rcpputils::SharedLibrary> introspection_;
  const MessageMembers * members_ = nullptr;
  std::optional<std::size_t> header_;
  ArrivalClock arrivals_;
  std::vector<Reader> readers_;
  std::string error_;
};

InputSubscriptions::InputSubscriptions(
  rclcpp::Node & node, const NodeClock & clock, std::size_t depth, OnError on_failure)
: node_(node), clock_(clock), depth_(depth), on_failure_(std::move(on_failure)) {}

InputSubscriptions::~InputSubscriptions() = default;

void InputSubscriptions::reset()
{
  for (const auto & topic : topics_) {topic->reset();}
}

Losses & InputSubscriptions::losses_of(const SignalSettings & signal) {return find_topic(signal)->losses;}

bool InputSubscriptions::subscribe(const SignalSettings & signal, Deliver deliver, OnError on_unreadable)
{
  const auto topic = find_topic(signal);
  topic->add(signal, std::move(deliver), std::move(on_unreadable));
  if (!topic->subscription) {create_subscription(signal, topic);}
  return topic->is_stamped();
}

std::shared_ptr<InputSubscriptions::Topic> InputSubscriptions::find_topic(const SignalSettings & signal)
{
  std::string name;
  try {
    name = node_.get_node_topics_interface()->resolve_topic_name(signal.topic);
  } catch (const std::exception &) {
    throw UserError(
      "signal '" + signal.name + "': '" + signal.topic +
      "' is not a topic name; expected letters, digits, '_' and '/'");
  }
  for (const auto & topic : topics_) {
    if (topic->name == name && topic->type == signal.type) {return topic;}
  }
  topics_.push_back(std::make_shared<Topic>(*this, name, signal));
  return topics_.back();
}

void InputSubscriptions::create_subscription(const SignalSettings & signal, const std::shared_ptr<Topic> & topic)
{
  const auto qos = rclcpp::QoS(depth_).best_effort();
  rclcpp::SubscriptionOptions options;
  options.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
  const auto subscribe_typed = [&](auto type) {
      using Message = typename decltype(type)::Message;
      topic->subscription = node_.create_subscription<Message>(
        signal.topic, qos, [topic = topic.get()](const Message & message, const rclcpp::MessageInfo & info) {
          topic->take(&message, info.get_rmw_message_info());
        },
        options, std::make_shared<ReusedMessage<Message>>());
    };
  if (visit_message_type(signal.type, subscribe_typed)) {return;}
  const auto library = rclcpp::get_typesupport_library(signal.type, "rosidl_typesupport_cpp");
  const auto * handle = rclcpp::get_message_typesupport_handle(signal.type, "rosidl_typesupport_cpp", *library);
  const auto message = std::make_shared<AnyMessage>(topic->members());
  const auto take = [topic = topic.get(), library, message, serialization = rclcpp::SerializationBase(handle),
      on_failure = on_failure_](
    std::shared_ptr<const rclcpp::SerializedMessage> bytes, const rclcpp::MessageInfo & info) {
      try {
        serialization.deserialize_message(bytes.get(), message->memory());
      } catch (const std::exception & error) {
        on_failure(error.what());
        return;
      }
      topic->take(message->memory(), info.get_rmw_message_info());
    };
  topic->subscription = node_.create_generic_subscription(signal.topic, signal.type, qos, take, options);
}

}  // namespace ces
