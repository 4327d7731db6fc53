// Reads one signal from messages in memory: the path of its field is resolved once, from the type's introspection.
#ifndef NODE__FIELD_READER_HPP_
#define NODE__FIELD_READER_HPP_

#include <optional>
#include <string>
#include <vector>

#include <rosidl_typesupport_introspection_cpp/message_introspection.hpp>
#include <std_msgs/msg/header.hpp>

#include "node/signal_parameters.hpp"

namespace ces
{

using rosidl_typesupport_introspection_cpp::MessageMember;
using rosidl_typesupport_introspection_cpp::MessageMembers;

class FieldReader
{
public:
  // Raises UserError if messages of this type have no number at the signal's field.
  FieldReader(const SignalSettings & signal, const MessageMembers & type);

  // The value [SI] in a message; nothing with `error` set if it lacks the joint or element. It allocates in that
  // case only.
  std::optional<double> read(const void * message, std::string & error) const;

private:
  // A field, and the element of it if it is an array: by index, or by the position of `joint` in one of `names`.
  struct Step
  {
    const MessageMember * member = nullptr;
    bool has_element = false;
    std::size_t index = 0;
    std::string joint;
    std::vector<const MessageMember *> names;
  };

  Step find_step(const std::string & part, const MessageMembers & type) const;
  void parse_element(const std::string & element, const MessageMembers & type, Step & step) const;
  std::optional<std::size_t> find_index(const Step & step, const void * parent, std::string & error) const;
  double convert(const void * number) const;

  std::string text_, where_;
  std::vector<Step> steps_;
  double scale_, offset_;
};

// The place of the header in messages of this type; nothing if they are not stamped.
std::optional<std::size_t> find_header(const MessageMembers & type);

}  // namespace ces

#endif  // NODE__FIELD_READER_HPP_
