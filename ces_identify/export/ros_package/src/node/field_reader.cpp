#include "node/field_reader.hpp"

#include <algorithm>
#include <cctype>
#include <cstring>

#include <rosidl_typesupport_introspection_cpp/field_types.hpp>

#include "node/user_error.hpp"

namespace ces
{
namespace
{

namespace types = rosidl_typesupport_introspection_cpp;

constexpr const char * JOINT_NAMES[] = {"name", "joint_names"};
constexpr std::size_t LONGEST_INDEX = 9;  // digits

const void * at_offset(const void * base, std::size_t offset) {return static_cast<const char *>(base) + offset;}

const MessageMembers & members_of(const MessageMember & member)
{
  return *static_cast<const MessageMembers *>(member.members_->data);
}

const MessageMember * find_member(const MessageMembers & type, const std::string & name)
{
  const auto * end = type.members_ + type.member_count_;
  const auto * found = std::find_if(
    type.members_, end, [&name](const MessageMember & member) {return name == member.name_;});
  return found == end ? nullptr : found;
}

std::string list_members(const MessageMembers & type)
{
  std::string names;
  for (std::uint32_t k = 0; k < type.member_count_; ++k) {names += std::string(k ? ", " : "") + type.members_[k].name_;}
  return names;
}

std::size_t count_elements(const MessageMember & member, const void * field)
{
  return member.size_function ? member.size_function(field) : member.array_size_;
}

std::string strip(const std::string & text)
{
  const auto first = text.find_first_not_of(' '), last = text.find_last_not_of(' ');
  return first == std::string::npos ? "" : text.substr(first, last - first + 1);
}

std::vector<std::string> split(const std::string & text)
{
  std::vector<std::string> parts{""};
  for (const char c : text) {
    if (c == '.') {
      parts.emplace_back();
    } else {
      parts.back() += c;
    }
  }
  for (auto & part : parts) {part = strip(part);}
  return parts;
}

bool is_name(const std::string & text)
{
  const auto is_word = [](char c) {return std::isalnum(static_cast<unsigned char>(c)) || c == '_';};
  return !text.empty() && std::isalpha(static_cast<unsigned char>(text[0])) &&
         std::all_of(text.begin(), text.end(), is_word);
}

bool is_number(std::uint8_t type)
{
  return type <= types::ROS_TYPE_INT64 && type != types::ROS_TYPE_LONG_DOUBLE && type != types::ROS_TYPE_WCHAR;
}

template<typename T>
double load(const void * number)
{
  T value;
  std::memcpy(&value, number, sizeof value);
  return static_cast<double>(value);
}

// The names as the Python observer writes them.
std::string describe_names(const MessageMember & member, const void * field)
{
  std::string text;
  for (std::size_t k = 0; k < member.size_function(field); ++k) {
    const auto & name = *static_cast<const std::string *>(member.get_const_function(field, k));
    text += std::string(k ? ", " : "") + "'" + name + "'";
  }
  return "[" + text + "]";
}

}  // namespace

FieldReader::FieldReader(const SignalSettings & signal, const MessageMembers & type)
: text_(signal.field), where_("signal '" + signal.name + "': field '" + signal.field + "' of " + signal.type),
  scale_(signal.scale), offset_(signal.offset)
{
  const auto * record = &type;
  for (const auto & part : split(signal.field)) {
    if (record == nullptr) {throw UserError(where_ + ": nothing is inside a number; omit '" + part + "'");}
    steps_.push_back(find_step(part, *record));
    const auto & member = *steps_.back().member;
    record = member.type_id_ == types::ROS_TYPE_MESSAGE ? &members_of(member) : nullptr;
  }
  const auto & last = steps_.back();
  if (!is_number(last.member->type_id_) || (last.member->is_array_ && !last.has_element)) {
    throw UserError(where_ + " is not a number; expected the path to a number");
  }
}

FieldReader::Step FieldReader::find_step(const std::string & part, const MessageMembers & type) const
{
  const auto open = part.find('[');
  const auto name = part.substr(0, open);
  const bool is_closed = open == std::string::npos || (part.back() == ']' && part.find(']') == part.size() - 1);
  if (!is_name(name) || !is_closed) {
    throw UserError(where_ + ": '" + part + "' is not a field name with an optional [index] or [joint name]");
  }
  Step step;
  step.member = find_member(type, name);
  if (step.member == nullptr) {throw UserError(where_ + ": no '" + name + "'; known are " + list_members(type));}
  if (open != std::string::npos) {parse_element(strip(part.substr(open + 1, part.size() - open - 2)), type, step);}
  if (step.member->is_array_ && !step.has_element) {
    throw UserError(where_ + ": '" + name + "' is an array; add [index] or [joint name]");
  }
  return step;
}

void FieldReader::parse_element(const std::string & element, const MessageMembers & type, Step & step) const
{
  if (!step.member->is_array_) {
    throw UserError(where_ + ": '" + step.member->name_ + "' is not an array; omit [" + element + "]");
  }
  if (element.empty()) {throw UserError(where_ + ": expected an index or a joint name in []");}
  step.has_element = true;
  const auto is_digit = [](char c) {return std::isdigit(static_cast<unsigned char>(c));};
  if (element.size() <= LONGEST_INDEX && std::all_of(element.begin(), element.end(), is_digit)) {
    step.index = std::stoul(element);
    return;
  }
  step.joint = element;
  for (const auto * name : JOINT_NAMES) {
    const auto * member = find_member(type, name);
    if (member && member->is_array_ && member->type_id_ == types::ROS_TYPE_STRING) {step.names.push_back(member);}
  }
  if (step.names.empty()) {throw UserError(where_ + ": no joint '" + element + "'; the message has no names");}
}

std::optional<double> FieldReader::read(const void * message, std::string & error) const
{
  const void * at = message;
  for (const auto & step : steps_) {
    const void * parent = at;
    at = at_offset(parent, step.member->offset_);
    if (!step.has_element) {continue;}
    const auto index = find_index(step, parent, error);
    if (!index) {return std::nullopt;}
    const auto count = count_elements(*step.member, at);
    if (*index >= count) {
      error = "field '" + text_ + "': index " + std::to_string(*index) + " is outside an array of " +
        std::to_string(count);
      return std::nullopt;
    }
    if (step.member->get_const_function == nullptr) {  // std::vector<bool>
      bool value = false;
      step.member->fetch_function(at, *index, &value);
      return scale_ * (value ? 1.0 : 0.0) + offset_;
    }
    at = step.member->get_const_function(at, *index);
  }
  return scale_ * convert(at) + offset_;
}

std::optional<std::size_t> FieldReader::find_index(const Step & step, const void * parent, std::string & error) const
{
  if (step.joint.empty()) {return step.index;}
  for (const auto * names : step.names) {
    const void * field = at_offset(parent, names->offset_);
    const auto count = names->size_function(field);
    if (count == 0) {continue;}
    for (std::size_t k = 0; k < count; ++k) {
      if (*static_cast<const std::string *>(names->get_const_function(field, k)) == step.joint) {return k;}
    }
    error = "field '" + text_ + "': no joint '" + step.joint + "'; the message has " + describe_names(*names, field);
    return std::nullopt;
  }
  error = "field '" + text_ + "': no joint '" + step.joint + "'; the message has no names";
  return std::nullopt;
}

double FieldReader::convert(const void * number) const
{
  switch (steps_.back().member->type_id_) {
    case types::ROS_TYPE_FLOAT: return load<float>(number);
    case types::ROS_TYPE_DOUBLE: return load<double>(number);
    case types::ROS_TYPE_BOOLEAN: return load<bool>(number);
    case types::ROS_TYPE_CHAR:
    case types::ROS_TYPE_OCTET:
    case types::ROS_TYPE_UINT8: return load<std::uint8_t>(number);
    case types::ROS_TYPE_INT8: return load<std::int8_t>(number);
    case types::ROS_TYPE_UINT16: return load<std::uint16_t>(number);
    case types::ROS_TYPE_INT16: return load<std::int16_t>(number);
    case types::ROS_TYPE_UINT32: return load<std::uint32_t>(number);
    case types::ROS_TYPE_INT32: return load<std::int32_t>(number);
    case types::ROS_TYPE_UINT64: return load<std::uint64_t>(number);
    default: return load<std::int64_t>(number);
  }
}

std::optional<std::size_t> find_header(const MessageMembers & type)
{
  const auto * header = find_member(type, "header");
  if (header == nullptr || header->is_array_ || header->type_id_ != types::ROS_TYPE_MESSAGE) {return std::nullopt;}
  const auto & kind = members_of(*header);
  const bool is_header =
    !std::strcmp(kind.message_namespace_, "std_msgs::msg") && !std::strcmp(kind.message_name_, "Header");
  return is_header ? std::optional<std::size_t>(header->offset_) : std::nullopt;
}

}  // namespace ces
