// Reads one signal from messages in memory: the path of its field is resolved once, from the type's introspection.
#pragma once

#include <cstring>
#include <regex>
#include <sstream>

#include <rosidl_typesupport_introspection_cpp/field_types.hpp>
#include <rosidl_typesupport_introspection_cpp/message_introspection.hpp>

#include "node/settings.hpp"

namespace ces {

namespace types = rosidl_typesupport_introspection_cpp;
using types::MessageMember;
using types::MessageMembers;

inline const MessageMembers & members_of(const MessageMember & member) {
  return *static_cast<const MessageMembers *>(member.members_->data);
}

inline const MessageMember * find_member(const MessageMembers & type, const std::string & name) {
  const auto * end = type.members_ + type.member_count_;
  const auto * found =
    std::find_if(type.members_, end, [&name](const MessageMember & member) {return name == member.name_;});
  return found == end ? nullptr : found;
}

// The place of the header in messages of this type; nothing if they are not stamped.
inline std::optional<std::size_t> find_header(const MessageMembers & type) {
  const auto * header = find_member(type, "header");
  if (header == nullptr || header->is_array_ || header->type_id_ != types::ROS_TYPE_MESSAGE) {return std::nullopt;}
  const auto & kind = members_of(*header);
  const bool is_header =
    !std::strcmp(kind.message_namespace_, "std_msgs::msg") && !std::strcmp(kind.message_name_, "Header");
  return is_header ? std::optional<std::size_t>(header->offset_) : std::nullopt;
}

class FieldReader {
public:
  // Raises UserError if messages of this type have no number at the signal's field.
  FieldReader(const SignalSettings & signal, const MessageMembers & type)
  : text_(signal.field), where_("signal '" + signal.name + "': field '" + signal.field + "' of " + signal.type),
    scale_(signal.scale), offset_(signal.offset) {
    const auto * record = &type;
    std::istringstream parts(signal.field + ".");
    for (std::string part; std::getline(parts, part, '.'); ) {
      if (record == nullptr) {throw UserError(where_ + ": nothing is inside a number; omit '" + part + "'");}
      steps_.push_back(find_step(part, *record));
      const auto & member = *steps_.back().member;
      record = member.type_id_ == types::ROS_TYPE_MESSAGE ? &members_of(member) : nullptr;
    }
    const auto last = steps_.back().member->type_id_;
    load_ = last < std::size(LOADS) ? LOADS[last] : nullptr;
    if (load_ == nullptr) {throw UserError(where_ + " is not a number; expected the path to a number");}
  }

  // Whether it reads the element of a joint by its name.
  bool is_named() const {
    return std::any_of(steps_.begin(), steps_.end(), [](const Step & step) {return !step.joint.empty();});
  }

  // The value [SI] in a message; nothing with `error` set if it lacks the joint or element, or if an index is another
  // joint than in the first message. It allocates in that case and for the first message only.
  std::optional<double> read(const void * message, std::string & error) {
    const void * at = message;
    for (auto & step : steps_) {
      const void * parent = at;
      const auto & member = *step.member;
      at = at_offset(parent, member.offset_);
      if (!member.is_array_) {continue;}
      const auto index = find_index(step, parent, error);
      if (!index) {return std::nullopt;}
      const auto count = member.size_function ? member.size_function(at) : member.array_size_;
      if (*index >= count) {
        error = "field '" + text_ + "': index " + std::to_string(*index) + " is outside an array of " +
          std::to_string(count);
        return std::nullopt;
      }
      if (!is_same_joint(step, parent, error)) {return std::nullopt;}
      if (member.get_const_function == nullptr) {  // std::vector<bool>
        bool value = false;
        member.fetch_function(at, *index, &value);
        return scale_ * (value ? 1.0 : 0.0) + offset_;
      }
      at = member.get_const_function(at, *index);
    }
    return scale_ * load_(at) + offset_;
  }

private:
  // A field, and the element of it if it is an array: by index, which is `first` in the first message that names it,
  // or by the position of `joint` in one of `names`.
  struct Step {
    const MessageMember * member = nullptr;
    std::size_t index = 0;
    std::string joint, first;
    std::vector<const MessageMember *> names;
  };

  static const void * at_offset(const void * base, std::size_t offset) {
    return static_cast<const char *>(base) + offset;
  }

  Step find_step(const std::string & part, const MessageMembers & type) const {
    static const std::regex FORM(" *([A-Za-z][A-Za-z0-9_]*)(\\[ *([^\\]]*?) *\\])? *");
    std::smatch found;
    if (!std::regex_match(part, found, FORM)) {
      throw UserError(where_ + ": '" + part + "' is not a field name with an optional [index] or [joint name]");
    }
    const std::string name = found[1], element = found[3];
    Step step;
    step.member = find_member(type, name);
    if (step.member == nullptr) {
      std::vector<std::string> known;
      for (std::uint32_t k = 0; k < type.member_count_; ++k) {known.push_back(type.members_[k].name_);}
      throw UserError(where_ + ": no '" + name + "'; known are " + join(known, ", "));
    }
    if (!step.member->is_array_ && found[2].matched) {
      throw UserError(where_ + ": '" + name + "' is not an array; omit [" + element + "]");
    }
    if (step.member->is_array_ && element.empty()) {
      throw UserError(where_ + ": '" + name + "' is an array; add [index] or [joint name]");
    }
    if (std::regex_match(element, std::regex("[0-9]{1,9}"))) {
      step.index = std::stoul(element);
    } else if (!element.empty()) {
      step.joint = element;
    }
    for (const auto * key : {"name", "joint_names", "interface_groups", "interface_names"}) {
      const auto * member = find_member(type, key);
      const bool is_list = member && member->is_array_ && member->type_id_ == types::ROS_TYPE_STRING;
      if (is_list) {step.names.push_back(member);}
    }
    if (!step.joint.empty() && step.names.empty()) {
      throw UserError(where_ + ": no joint '" + element + "'; the message has no names");
    }
    return step;
  }

  std::optional<std::size_t> find_index(const Step & step, const void * parent, std::string & error) const {
    if (step.joint.empty()) {return step.index;}
    for (const auto * names : step.names) {
      const void * field = at_offset(parent, names->offset_);
      const auto count = names->size_function(field);
      const auto name_at = [&](std::size_t k) -> const std::string & {
          return *static_cast<const std::string *>(names->get_const_function(field, k));
        };
      for (std::size_t k = 0; k < count; ++k) {
        if (name_at(k) == step.joint) {return k;}
      }
      if (count == 0) {continue;}
      std::vector<std::string> known;  // as the Python observer writes them
      for (std::size_t k = 0; k < count; ++k) {known.push_back("'" + name_at(k) + "'");}
      error = "field '" + text_ + "': no joint '" + step.joint + "'; the message has [" + join(known, ", ") + "]";
      return std::nullopt;
    }
    error = "field '" + text_ + "': no joint '" + step.joint + "'; the message has no names";
    return std::nullopt;
  }

  // Whether the index of a step is the joint of the first message that names it; else `error` is set.
  bool is_same_joint(Step & step, const void * parent, std::string & error) const {
    if (!step.joint.empty()) {return true;}
    for (const auto * names : step.names) {
      const void * field = at_offset(parent, names->offset_);
      const auto count = names->size_function(field);
      if (count == 0) {continue;}
      if (step.index >= count) {return true;}
      const auto & name = *static_cast<const std::string *>(names->get_const_function(field, step.index));
      if (step.first.empty()) {step.first = name;}
      if (name == step.first) {return true;}
      const std::string field_name = step.member->name_;
      error = "field '" + text_ + "' is " + field_name + "[" + step.first + "] in the first message and " + field_name +
        "[" + name + "] in another; take it by name";
      return false;
    }
    return true;
  }

  using Load = double (*)(const void *);

  template<typename T>
  static double load(const void * number) {
    T value;
    std::memcpy(&value, number, sizeof value);
    return static_cast<double>(value);
  }

  static_assert(types::ROS_TYPE_FLOAT == 1 && types::ROS_TYPE_BOOLEAN == 6 && types::ROS_TYPE_INT64 == 15);
  static constexpr Load LOADS[] = {  // by the number of the type
    nullptr, load<float>, load<double>, nullptr, load<std::uint8_t>, nullptr, load<bool>, load<std::uint8_t>,
    load<std::uint8_t>, load<std::int8_t>, load<std::uint16_t>, load<std::int16_t>, load<std::uint32_t>,
    load<std::int32_t>, load<std::uint64_t>, load<std::int64_t>};

  std::string text_, where_;
  std::vector<Step> steps_;
  double scale_, offset_;
  Load load_ = nullptr;
};

}  // namespace ces
