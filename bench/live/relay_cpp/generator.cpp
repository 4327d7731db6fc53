// Publishes joint_states and valve_current on a steady schedule, receives the estimates and the node's diagnostics, and
// prints one line of JSON: latency [us] from stamp to received estimate, CPU share of the process under test, and how
// late [us] this program itself woke up, which measures the disturbance by the machine. The samples of the whole run are
// accounted for:
//   all_sent = arrived + lost_in;  arrived = estimated + withheld;  estimated = received + lost_out
// `arrived` and `estimated` are the node's own counts. A relay has none: its lost_in are all samples that did not return.
// Usage: generator PRIORITY --ros-args ... With a priority from 1 to 99 the program runs under SCHED_FIFO, if that is
// permitted, so that it publishes on time beside other load; `priority` in the output is the one in force, 0 if none.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <unordered_map>

#include <std_msgs/msg/float64.hpp>

#include "clocks.hpp"
#include "listener.hpp"

using sensor_msgs::msg::JointState;
using std_msgs::msg::Float64;

constexpr double LATE_S = 0.5;  // estimates received later than this after their stamps are counted as late
constexpr double MATCHED_S = 1.0;  // from matching to the first sample: each side learns of the other on its own
constexpr double REPORTED_S = 2.6;  // from the last sample to the node's last counts: diagnostics come once a second

struct Plan
{
  double rate_Hz, warm_up_s, seconds;
  int pid, current_every;
  bool current_apart;
  std::string observed;
};

struct Sent
{
  std::vector<Nanoseconds> stamps, late;
  size_t warm = 0;  // samples of the warm-up, at the front
  double cpu_share = 0.0;
};

class Generator
{
public:
  Generator(rclcpp::Node & node, const Plan & plan)
  : plan_(plan), position_(node.create_publisher<JointState>("joint_states", 5000)),
    current_(node.create_publisher<Float64>("valve_current", 5000))
  {
    sample_.header.frame_id = "chassis";
    sample_.name = {"front_damper", "rear_damper"};
    sample_.position = {0.0, 0.0};
  }

  bool is_matched() const {return position_->get_subscription_count() > 0;}

  Sent run()
  {
    const Nanoseconds period = std::llround(SECOND / plan_.rate_Hz), start = read_clock(CLOCK_MONOTONIC) + period;
    const auto count = std::llround((plan_.warm_up_s + plan_.seconds) * plan_.rate_Hz);
    clockid_t process;
    if (clock_getcpuclockid(plan_.pid, &process) != 0) {throw std::runtime_error("no such process under test");}
    Sent sent;
    sent.warm = static_cast<size_t>(std::llround(plan_.warm_up_s * plan_.rate_Hz));
    sent.stamps.reserve(count);
    sent.late.reserve(count);
    Nanoseconds cpu = 0, wall = start;
    for (int64_t k = 0; k < count; ++k) {
      const auto due = start + k * period;
      sleep_until(due);
      if (sent.stamps.size() == sent.warm) {
        cpu = read_clock(process);
        wall = read_clock(CLOCK_MONOTONIC);
      }
      sent.late.push_back(read_clock(CLOCK_MONOTONIC) - due);
      sent.stamps.push_back(publish_position());
      if (k % plan_.current_every == 0) {publish_current(due + period / 2);}
    }
    sent.cpu_share = double(read_clock(process) - cpu) / double(read_clock(CLOCK_MONOTONIC) - wall);
    return sent;
  }

private:
  Nanoseconds publish_position()
  {
    const auto now = read_clock(CLOCK_REALTIME);
    sample_.position[1] = 0.02 * std::sin(2.0 * M_PI * 2.0 * 1e-9 * (now % SECOND));
    sample_.header.stamp.sec = static_cast<int32_t>(now / SECOND);
    sample_.header.stamp.nanosec = static_cast<uint32_t>(now % SECOND);
    position_->publish(sample_);
    return now;
  }

  void publish_current(Nanoseconds apart_at)
  {
    if (plan_.current_apart) {sleep_until(apart_at);}
    Float64 current;
    current.data = 0.5;
    current_->publish(current);
  }

  Plan plan_;
  rclcpp::Publisher<JointState>::SharedPtr position_;
  rclcpp::Publisher<Float64>::SharedPtr current_;
  JointState sample_;
};

double percentile(std::vector<Nanoseconds> & values, double share)  // [us]
{
  if (values.empty()) {return NAN;}
  const auto at = values.begin() + static_cast<int64_t>(share * (values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at * 1e-3;
}

struct Found
{
  std::vector<Nanoseconds> latencies;  // of the window, warm-up left out
  size_t late = 0, received = 0;  // `received` of the whole run
};

Found compare(const Sent & sent, const std::vector<Heard> & heard)
{
  std::unordered_map<Nanoseconds, Nanoseconds> arrivals;
  for (const auto & one : heard) {arrivals.emplace(one.stamp, one.at);}
  Found found;
  for (size_t k = 0; k < sent.stamps.size(); ++k) {
    const auto one = arrivals.find(sent.stamps[k]);
    if (one == arrivals.end()) {continue;}
    ++found.received;
    if (k < sent.warm) {continue;}
    found.latencies.push_back(one->second - one->first);
    found.late += found.latencies.back() > LATE_S * SECOND;
  }
  return found;
}

// What was lost on either side of the node, and what it withheld by its own counts.
void print_accounts(const Sent & sent, const Found & found, const Counts & before, const Counts & after)
{
  const auto of = [&](const std::string & key) {
      return (after.count(key) ? after.at(key) : 0) - (before.count(key) ? before.at(key) : 0);
    };
  const auto all = static_cast<int64_t>(sent.stamps.size()), received = static_cast<int64_t>(found.received);
  const auto arrived = after.empty() ? received : of("position samples");
  const auto estimated = after.empty() ? received : of("forces estimated");
  std::printf("\"all_sent\": %ld, \"lost_in\": %ld, \"lost_out\": %ld, \"withheld\": {", all, all - arrived, estimated - received);
  const char * separator = "";
  for (const auto & [key, value] : after) {
    if (key.compare(0, 10, "withheld: ") != 0 || of(key) == 0) {continue;}
    std::printf("%s\"%s\": %ld", separator, key.substr(10).c_str(), of(key));
    separator = ", ";
  }
  std::printf("}");
}

void report(Sent & sent, Found found, const Counts & before, const Counts & after, int priority)
{
  if (found.latencies.empty()) {throw std::runtime_error("not one estimate was received");}
  const auto window = sent.stamps.size() - sent.warm;
  std::vector<Nanoseconds> late(sent.late.begin() + sent.warm, sent.late.end());
  std::printf("{\"sent\": %zu, \"received\": %zu, \"late\": %zu, ", window, found.latencies.size(), found.late);
  print_accounts(sent, found, before, after);
  auto & latencies = found.latencies;
  std::printf(
    ", \"p50_us\": %.1f, \"p99_us\": %.1f, \"max_us\": %.1f, \"cpu_share\": %.5f, \"late_p50_us\": %.1f, "
    "\"late_p99_us\": %.1f, \"late_max_us\": %.1f, \"priority\": %d}\n",
    percentile(latencies, 0.5), percentile(latencies, 0.99), percentile(latencies, 1.0), sent.cpu_share,
    percentile(late, 0.5), percentile(late, 0.99), percentile(late, 1.0), priority);
}

Plan declare_plan(rclcpp::Node & node)
{
  return {
    node.declare_parameter("rate_Hz", 1000.0), node.declare_parameter("warm_up_s", 2.0),
    node.declare_parameter("seconds", 5.0), static_cast<int>(node.declare_parameter("pid", 0)),
    static_cast<int>(node.declare_parameter("current_every", 1)), node.declare_parameter("current_apart", false),
    node.declare_parameter("observed", "")};
}

// Wait until both sides have matched, and a node that has diagnostics has reported its first counts.
void wait_for_node(const Generator & generator, Listener & listener, bool has_counts)
{
  const auto limit = read_clock(CLOCK_MONOTONIC) + 20 * SECOND;
  const auto is_ready = [&] {
      return generator.is_matched() && listener.is_matched() && !(has_counts && listener.counts().empty());
    };
  while (!is_ready() && read_clock(CLOCK_MONOTONIC) < limit) {sleep_for(0.01);}
  sleep_for(MATCHED_S);
}

void measure(int priority)
{
  rclcpp::Node node("generator");
  const auto plan = declare_plan(node);
  const bool has_counts = !plan.observed.empty();
  Generator generator(node, plan);
  Listener listener(node, plan.observed, static_cast<size_t>((plan.warm_up_s + plan.seconds) * plan.rate_Hz * 1.1) + 1000);
  wait_for_node(generator, listener, has_counts);
  const auto before = listener.counts();
  auto sent = generator.run();
  sleep_for(has_counts ? REPORTED_S : LATE_S);
  const auto after = listener.counts();
  report(sent, compare(sent, listener.end()), before, after, priority);
}

int main(int argc, char ** argv)
{
  const auto priority = use_priority(argc > 1 ? std::atoi(argv[1]) : 0);  // inherited by the threads of DDS
  rclcpp::init(argc, argv);
  int status = 0;
  try {
    measure(priority);
  } catch (const std::exception & error) {
    std::fprintf(stderr, "generator: %s\n", error.what());
    status = 1;
  }
  rclcpp::shutdown();
  return status;
}
