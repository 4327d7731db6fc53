// Memory of received messages that is used again, so that their strings and arrays are allocated once.
#ifndef NODE__MESSAGE_MEMORY_HPP_
#define NODE__MESSAGE_MEMORY_HPP_

#include <cstddef>
#include <memory>
#include <new>

#include <rclcpp/message_memory_strategy.hpp>
#include <rosidl_typesupport_introspection_cpp/message_introspection.hpp>

namespace ces
{

// That of a subscription to messages of a type that is compiled in.
template<typename Message>
class ReusedMessage : public rclcpp::message_memory_strategy::MessageMemoryStrategy<Message>
{
public:
  std::shared_ptr<Message> borrow_message() override
  {
    if (message_.use_count() != 1) {message_ = std::make_shared<Message>();}
    return message_;
  }

private:
  std::shared_ptr<Message> message_;
};

// A message of a type that is known at run time only.
class AnyMessage
{
public:
  explicit AnyMessage(const rosidl_typesupport_introspection_cpp::MessageMembers & type)
  : type_(type), memory_(::operator new(type.size_of_, std::align_val_t(alignof(std::max_align_t))))
  {
    type_.init_function(memory_, rosidl_runtime_cpp::MessageInitialization::ALL);
  }

  AnyMessage(const AnyMessage &) = delete;
  AnyMessage & operator=(const AnyMessage &) = delete;

  ~AnyMessage()
  {
    type_.fini_function(memory_);
    ::operator delete(memory_, std::align_val_t(alignof(std::max_align_t)));
  }

  void * memory() {return memory_;}

private:
  const rosidl_typesupport_introspection_cpp::MessageMembers & type_;
  void * memory_;
};

}  // namespace ces

#endif  // NODE__MESSAGE_MEMORY_HPP_
