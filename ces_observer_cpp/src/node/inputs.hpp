// The node's time and subscriptions: one for each topic and type, with any number of signals.
//
// The types of the default signals arrive as messages, within a process without a copy. Any other installed type
// arrives as bytes and is deserialised into one message that is kept.
#pragma once

#include <memory>

#include <rclcpp/rclcpp.hpp>
#include <rclcpp/serialization.hpp>
#include <rclcpp/typesupport_helpers.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/float64.hpp>

#include "core/clocks.hpp"
#include "health/arrivals.hpp"
#include "node/field_reader.hpp"

namespace ces {

using OnText = std::function<void(const std::string &)>;

// The node's time in nanoseconds, and callbacks on jumps of simulated time or the wall clock.
class NodeClock {
public:
  // `on_jump` is called with a line of text after each time jump. Simulated time is 0 until its first /clock
  // message, which is no jump: samples may arrive before it.
  NodeClock(Node & node, OnText on_jump)
  : clock_(node.get_clock()), on_jump_(std::move(on_jump)) {
    rcl_jump_threshold_t threshold;
    threshold.on_clock_change = true;
    threshold.min_forward.nanoseconds = FORWARD;
    threshold.min_backward.nanoseconds = BACKWARD;
    jumps_ = clock_->create_jump_callback(
      nullptr, [this](const rcl_time_jump_t & jump) {report(jump);}, threshold);
  }

  Nanoseconds now() const {return clock_->now().nanoseconds();}

  bool is_simulated() const {return clock_->ros_time_is_active();}

  // Check now and then whether the wall clock was set: rcl reports only jumps of simulated time.
  void watch() {
    const auto before = ahead_, jump = (ahead_ = measure_ahead()) - before;
    if (std::llabs(jump) >= MIN_JUMP && !is_simulated()) {
      on_jump_("the wall clock was set by " + format_number("%+.3f", to_s(jump)) + " s");
    }
  }

private:
  // The steps of /clock in a fast replay are no jumps. The samples' stamps show shorter jumps.
  static constexpr Nanoseconds FORWARD = 5 * SECOND, BACKWARD = -1'000'000;
  static constexpr Nanoseconds MIN_JUMP = 100'000'000;  // far above what a slewed clock gains between two readings

  static Nanoseconds measure_ahead() {return read_clock(CLOCK_REALTIME) - read_clock(CLOCK_MONOTONIC);}

  void report(const rcl_time_jump_t & jump) {
    if (jump.clock_change == RCL_ROS_TIME_ACTIVATED) {
      on_jump_("simulated time was switched on");
    } else if (jump.clock_change == RCL_ROS_TIME_DEACTIVATED) {
      on_jump_("simulated time was switched off");
    } else if (now() != jump.delta.nanoseconds) {
      on_jump_("simulated time jumped by " + format_number("%+.3f", to_s(jump.delta.nanoseconds)) + " s");
    }
  }

  rclcpp::Clock::SharedPtr clock_;
  OnText on_jump_;
  Nanoseconds ahead_ = measure_ahead();  // of the wall clock
  rclcpp::JumpHandler::SharedPtr jumps_;
};

// Receives messages of a compiled type into one that is used again, so that its strings and arrays are allocated once.
template<typename Message>
class ReusedMessage : public rclcpp::message_memory_strategy::MessageMemoryStrategy<Message> {
public:
  std::shared_ptr<Message> borrow_message() override {
    if (message_.use_count() != 1) {message_ = std::make_shared<Message>();}
    return message_;
  }

private:
  std::shared_ptr<Message> message_;
};

// The memory of a message of a type that is known at run time only.
inline std::shared_ptr<void> make_message(const MessageMembers & type) {
  constexpr std::align_val_t ALIGNMENT{alignof(std::max_align_t)};
  void * memory = ::operator new(type.size_of_, ALIGNMENT);
  type.init_function(memory, rosidl_runtime_cpp::MessageInitialization::ALL);
  return {memory, [&type](void * message) {
      type.fini_function(message);
      ::operator delete(message, ALIGNMENT);
    }};
}

// The types of what is published on a topic.
inline std::set<std::string> find_types(const Node & node, const std::string & topic) {
  std::set<std::string> types;
  for (const auto & publisher : node.get_publishers_info_by_topic(topic)) {types.insert(publisher.topic_type());}
  return types;
}

class Inputs {
public:
  // Stamp, value [SI], frame id, the node's time on arrival.
  using Deliver = std::function<void(Nanoseconds, double, const std::string &, Nanoseconds)>;

  // Queues hold `depth` messages. `on_failure` is called with unexpected errors; no message throws out of a callback.
  // `on_silence` is called with a topic that has missed its deadline, or whose last publisher is gone.
  Inputs(Node & node, const NodeClock & clock, std::size_t depth, OnText on_failure, OnText on_silence)
  : node_(node), clock_(clock), depth_(depth), on_failure_(std::move(on_failure)), on_silence_(std::move(on_silence)) {}

  // Forget the delays of messages, as after a time jump.
  void reset() {
    for (const auto & topic : topics_) {topic->arrivals = ArrivalClock();}
  }

  // A sentence on publishers whose type is not that of their topic's signal, or that are too many; empty without any.
  // Several may publish the same topic where the field names a joint.
  std::string find_mismatch() const {
    std::vector<std::string> found;
    for (const auto & topic : topics_) {
      const auto count = topic->subscription->get_publisher_count();
      const bool is_named = std::all_of(
        topic->readers.begin(), topic->readers.end(), [](const Reader & one) {return one.field.is_named();});
      if (count > 1 && !is_named) {
        found.push_back(topic->name + " has " + std::to_string(count) + " publishers, whose samples mix; expected one");
      }
      if (node_.count_publishers(topic->name) <= count) {continue;}
      auto types = find_types(node_, topic->name);
      types.erase(topic->signal.type);
      if (!types.empty()) {
        found.push_back(
          topic->name + " also carries " + join(types, ", ") + ", which is not read; " + topic->signal.name +
          ".type is " + topic->signal.type);
      }
    }
    return join(found, "; ");
  }

  // Deliver each sample of `signal`, or the error that makes a message unreadable; its arrivals are counted in
  // `arrivals`. A sample without a stamp is stamped with its arrival (ArrivalClock); the delay is taken off the
  // stamps. Signals in one message are delivered in the order of their subscriptions. Raises UserError if topic, type
  // or field is wrong.
  void subscribe(const SignalSettings & signal, Deliver deliver, OnText on_unreadable, Arrivals * arrivals) {
    const auto topic = find_topic(signal);
    topic->readers.push_back(
      {FieldReader(signal, *topic->members), to_ns(signal.delay_s), std::move(deliver), std::move(on_unreadable)});
    if (!topic->subscription) {create_subscription(topic);}
    if (arrivals != nullptr) {arrivals->set_topic(topic->header.has_value(), topic->losses);}
    if (!topic->header) {
      RCLCPP_WARN(
        node_.get_logger(), "signal '%s': %s has no header; samples are stamped with their arrival",
        signal.name.c_str(), signal.type.c_str());
    }
  }

private:
  struct Reader {
    FieldReader field;
    Nanoseconds delay;
    Deliver deliver;
    OnText on_unreadable;
  };

  // One topic with the readers of its signals.
  struct Topic {
    std::string name;
    SignalSettings signal;  // one of those in it
    Losses losses;
    std::shared_ptr<rcpputils::SharedLibrary> introspection = nullptr;
    const MessageMembers * members = nullptr;
    std::optional<std::size_t> header = std::nullopt;  // its place in the messages
    ArrivalClock arrivals{};
    std::vector<Reader> readers{};
    rclcpp::SubscriptionBase::SharedPtr subscription = nullptr;
    std::string error = "";
  };

  // Read a message; the callback of a subscription.
  void take(Topic & topic, const void * message, const rmw_message_info_t & info) {
    try {
      const auto now = clock_.now();
      const auto number = info.publication_sequence_number;
      const bool is_local = info.from_intra_process;  // rclcpp leaves the rest of `info` unset
      const bool has_number = !is_local && number != RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED && number != 0;
      topic.losses.take_number(has_number ? std::optional<std::uint64_t>(number) : std::nullopt);
      static const std::string NO_FRAME;
      const auto * header = topic.header ? reinterpret_cast<const std_msgs::msg::Header *>(
        static_cast<const char *>(message) + *topic.header) : nullptr;
      // Simulated time does not show when a message without a stamp was sent.
      const auto stamp = header ? header->stamp.sec * SECOND + header->stamp.nanosec :
        is_local || clock_.is_simulated() ? now : topic.arrivals.stamp(info.source_timestamp, now);
      for (auto & reader : topic.readers) {
        if (const auto value = reader.field.read(message, topic.error)) {
          reader.deliver(stamp - reader.delay, *value, header ? header->frame_id : NO_FRAME, now);
        } else {
          reader.on_unreadable(topic.error);
        }
      }
    } catch (const std::exception & error) {  // no message may stop the next ones
      on_failure_(error.what());
    }
  }

  std::shared_ptr<Topic> find_topic(const SignalSettings & signal) {
    const auto where = "signal '" + signal.name + "': ";
    auto topic = std::make_shared<Topic>(Topic{"", signal, Losses(depth_)});
    try {
      topic->name = node_.get_node_topics_interface()->resolve_topic_name(signal.topic);
    } catch (const std::exception &) {
      throw UserError(where + "'" + signal.topic + "' is not a topic name; expected letters, digits, '_' and '/'");
    }
    for (const auto & known : topics_) {
      if (known->name == topic->name && known->signal.type == signal.type) {return known;}
    }
    try {
      const std::string support = "rosidl_typesupport_introspection_cpp";
      topic->introspection = rclcpp::get_typesupport_library(signal.type, support);
      topic->members = static_cast<const MessageMembers *>(
        rclcpp::get_message_typesupport_handle(signal.type, support, *topic->introspection)->data);
    } catch (const std::exception &) {
      throw UserError(
        where + "message type '" + signal.type + "' is not installed; check " + signal.name +
        ".type, or source the workspace that has it");
    }
    topic->header = find_header(*topic->members);
    topics_.push_back(topic);
    return topic;
  }

  // The executor may hold a message that is read after the topics are closed: its callback then does nothing.
  void create_subscription(const std::shared_ptr<Topic> & topic) {
    const auto & signal = topic->signal;
    using Kind = rclcpp::QosPolicyKind;
    const rclcpp::QosOverridingOptions overridable{
      Kind::History, Kind::Depth, Kind::Reliability, Kind::Deadline, Kind::Liveliness, Kind::LivelinessLeaseDuration};
    const auto qos = rclcpp::detail::declare_qos_parameters(  // generic subscriptions do not read overrides themselves
      overridable, node_, topic->name, rclcpp::QoS(depth_).best_effort(),
      rclcpp::detail::SubscriptionQosParametersTraits{});
    rclcpp::SubscriptionOptions options;
    const auto tell = [this, weak = std::weak_ptr(topic)] {
        if (const auto open = weak.lock()) {on_silence_(open->name);}
      };
    options.event_callbacks.deadline_callback = [tell](rclcpp::QOSDeadlineRequestedInfo &) {tell();};
    options.event_callbacks.liveliness_callback = [tell](rclcpp::QOSLivelinessChangedInfo & change) {
        if (change.alive_count == 0 && change.alive_count_change < 0) {tell();}
      };
    const auto subscribe_typed = [&](auto message) {
        using Message = decltype(message);
        topic->subscription = node_.create_subscription<Message>(
          signal.topic, qos, [this, weak = std::weak_ptr(topic)](
            const Message & heard, const rclcpp::MessageInfo & info) {
            if (const auto open = weak.lock()) {take(*open, &heard, info.get_rmw_message_info());}
          },
          options, std::make_shared<ReusedMessage<Message>>());
      };
    if (signal.type == "sensor_msgs/msg/JointState") {return subscribe_typed(sensor_msgs::msg::JointState());}
    if (signal.type == "std_msgs/msg/Float64") {return subscribe_typed(std_msgs::msg::Float64());}
    const auto library = rclcpp::get_typesupport_library(signal.type, "rosidl_typesupport_cpp");
    const auto * handle = rclcpp::get_message_typesupport_handle(signal.type, "rosidl_typesupport_cpp", *library);
    const auto take_bytes = [this, weak = std::weak_ptr(topic), library, introspection = topic->introspection,
        message = make_message(*topic->members), serialization = rclcpp::SerializationBase(handle)](
      std::shared_ptr<const rclcpp::SerializedMessage> bytes, const rclcpp::MessageInfo & info) {
        const auto open = weak.lock();
        if (!open) {return;}
        try {
          serialization.deserialize_message(bytes.get(), message.get());
        } catch (const std::exception & error) {
          on_failure_(error.what());
          return;
        }
        take(*open, message.get(), info.get_rmw_message_info());
      };
    topic->subscription = rclcpp::create_generic_subscription(
      node_.get_node_topics_interface(), signal.topic, signal.type, qos, take_bytes, options);
  }

  Node & node_;
  const NodeClock & clock_;
  std::size_t depth_;
  OnText on_failure_, on_silence_;
  std::vector<std::shared_ptr<Topic>> topics_;
};

}  // namespace ces
