// The node's parameter services, as those of rclcpp; but here each request gets an answer, whatever it holds.
#pragma once

#include <rcl_interfaces/srv/describe_parameters.hpp>
#include <rcl_interfaces/srv/get_parameter_types.hpp>
#include <rcl_interfaces/srv/get_parameters.hpp>
#include <rcl_interfaces/srv/list_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters_atomically.hpp>

#include "node/settings.hpp"

namespace ces {

class ParameterServices {
public:
  // `is_in_use` says whether the node is configured, so that it has read what is not live; `answer` what became of the
  // parameter that was just set, empty if there is no more to say.
  ParameterServices(Node & node, std::function<bool()> is_in_use, std::function<std::string()> answer)
  : node_(node), is_in_use_(std::move(is_in_use)), answer_(std::move(answer)) {
    using namespace rcl_interfaces::srv;
    serve<GetParameters>("get_parameters", [&node](const auto & request, auto & response) {
        for (const auto & one : node.get_parameters(request.names)) {
          response.values.push_back(one.get_value_message());
        }
      });
    serve<GetParameterTypes>("get_parameter_types", [&node](const auto & request, auto & response) {
        response.types = node.get_parameter_types(request.names);
      });
    serve<DescribeParameters>("describe_parameters", [&node](const auto & request, auto & response) {
        response.descriptors = node.describe_parameters(request.names);
      });
    serve<ListParameters>("list_parameters", [&node](const auto & request, auto & response) {
        response.result = node.list_parameters(request.prefixes, request.depth);
      });
    serve<SetParameters>("set_parameters", [this](const auto & request, auto & response) {
        const auto count = request.parameters.size();
        response.results.assign(count, count > MAX_COUNT ? set(request.parameters) : Result());
        for (std::size_t k = 0; k < count && count <= MAX_COUNT; ++k) {
          response.results[k] = set({request.parameters[k]});
        }
      });
    serve<SetParametersAtomically>("set_parameters_atomically", [this](const auto & request, auto & response) {
        response.result = set(request.parameters);
      });
  }

private:
  using Message = rcl_interfaces::msg::Parameter;
  using Result = rcl_interfaces::msg::SetParametersResult;

  static constexpr std::size_t MAX_COUNT = 500, MAX_NAME = 1000, MAX_VALUE = 10'000;

  template<typename Service, typename Answer>
  void serve(const std::string & name, const Answer & answer) {
    const auto take = [answer](
      const std::shared_ptr<typename Service::Request> request, std::shared_ptr<typename Service::Response> response) {
        try {
          answer(*request, *response);
        } catch (const std::exception &) {  // a name that is not declared: nothing is in the answer
        }
      };
    services_.push_back(node_.create_service<Service>("~/" + name, take, rclcpp::ParametersQoS()));
  }

  // Why a value cannot be set; empty if that is left to rclcpp and parameters.yaml.
  std::string find_refusal(const Message & one) const {
    const auto what = "parameter '" + one.name + "' ";
    const auto & value = one.value;
    const auto longest = std::max({
        value.string_value.size(), value.byte_array_value.size(), value.bool_array_value.size(),
        value.integer_array_value.size(), value.double_array_value.size(), value.string_array_value.size()});
    return
      one.name.size() > MAX_NAME ?
      fmt::format("a parameter's name of {} characters; expected at most {}", one.name.size(), MAX_NAME) :
      value.type > rclcpp::PARAMETER_STRING_ARRAY ? what + fmt::format("has a value of unknown type {}", value.type) :
      longest > MAX_VALUE ?
      what + fmt::format("has {} characters or elements; expected at most {}", longest, MAX_VALUE) :
      !node_.has_parameter(one.name) ? what + "cannot be set because it was not declared" :
      is_in_use_() && std::count(std::begin(IDLE_ONLY), std::end(IDLE_ONLY), one.name) ?
      what + "cannot be set because " + IN_USE : "";
  }

  Result set(const std::vector<Message> & messages) const {
    Result result;
    std::vector<rclcpp::Parameter> parameters;
    try {
      if (messages.size() > MAX_COUNT) {
        throw UserError(fmt::format("{} parameters in one request; expected at most {}", messages.size(), MAX_COUNT));
      }
      for (const auto & one : messages) {
        if (const auto refusal = find_refusal(one); !refusal.empty()) {throw UserError(refusal);}
        parameters.push_back(rclcpp::Parameter::from_parameter_msg(one));
      }
      result = node_.set_parameters_atomically(parameters);
      const auto said = answer_();
      if (result.successful) {result.reason = said;}
      return result;
    } catch (const std::exception & error) {
      result.reason = error.what();
      return result;
    }
  }

  Node & node_;
  std::function<bool()> is_in_use_;
  std::function<std::string()> answer_;
  std::vector<rclcpp::ServiceBase::SharedPtr> services_;
};

}  // namespace ces
