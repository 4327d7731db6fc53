// Publishes joint_states and valve_current on a steady schedule, receives the estimates, and prints one line of JSON:
// latency [us] from stamp to received estimate, samples sent and lost, CPU share of the process under test, and how
// late [us] this program itself woke up, which measures the disturbance by the machine. After a pause of its own, longer than
// the model bridges, the observer must warm up again: samples without an estimate are then counted separately.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <stdexcept>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/float64.hpp>

using sensor_msgs::msg::JointState;
using std_msgs::msg::Float64;
using Nanoseconds = int64_t;

constexpr Nanoseconds SECOND = 1'000'000'000;
constexpr double GRACE_S = 0.5;  // later estimates count as lost

Nanoseconds read_clock(clockid_t clock)
{
  timespec time{};
  if (clock_gettime(clock, &time) != 0) {throw std::runtime_error("the process under test has ended");}
  return time.tv_sec * SECOND + time.tv_nsec;
}

void sleep_until(Nanoseconds at)
{
  const timespec time{at / SECOND, at % SECOND};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) != 0) {}
}

struct Plan
{
  double rate_Hz, warm_up_s, seconds, max_gap_s, after_gap_s;
  int pid, current_every;
  bool current_apart;
};

struct Heard {Nanoseconds stamp, at;};

// Estimates with their times of arrival, received by a separate thread.
class Listener
{
public:
  Listener(rclcpp::Node & node, size_t most)
  : subscription_(node.create_subscription<JointState>(
        "estimate", rclcpp::QoS(1000), [](JointState::UniquePtr) {}))
  {
    heard_.reserve(most);
    waits_.add_subscription(subscription_);
    thread_ = std::thread([this] {listen();});
  }

  ~Listener() {stop();}

  std::vector<Heard> end()
  {
    stop();
    return std::move(heard_);
  }

  bool is_matched() const {return subscription_->get_publisher_count() > 0;}

private:
  void stop()
  {
    running_ = false;
    if (thread_.joinable()) {thread_.join();}
  }

  void listen()
  {
    JointState message;
    rclcpp::MessageInfo info;
    while (running_) {
      if (waits_.wait(std::chrono::milliseconds(100)).kind() != rclcpp::WaitResultKind::Ready) {continue;}
      while (subscription_->take(message, info)) {
        const auto now = read_clock(CLOCK_REALTIME);
        heard_.push_back({message.header.stamp.sec * SECOND + message.header.stamp.nanosec, now});
      }
    }
  }

  rclcpp::Subscription<JointState>::SharedPtr subscription_;
  rclcpp::WaitSet waits_;
  std::vector<Heard> heard_;
  std::atomic<bool> running_{true};
  std::thread thread_;
};

struct Sent
{
  std::vector<Nanoseconds> stamps, late;  // of the window, warm-up left out
  double cpu_share = 0.0;
};

class Generator
{
public:
  Generator(rclcpp::Node & node, const Plan & plan)
  : plan_(plan), position_(node.create_publisher<JointState>("joint_states", 100)),
    current_(node.create_publisher<Float64>("valve_current", 100))
  {
    sample_.header.frame_id = "chassis";
    sample_.name = {"front_damper", "rear_damper"};
    sample_.position = {0.0, 0.0};
  }

  bool is_matched() const {return position_->get_subscription_count() > 0;}

  Sent run()
  {
    const Nanoseconds period = std::llround(SECOND / plan_.rate_Hz), start = read_clock(CLOCK_MONOTONIC) + period;
    const auto warm = std::llround(plan_.warm_up_s * plan_.rate_Hz), count = std::llround(plan_.seconds * plan_.rate_Hz);
    const auto wall = start + warm * period;
    clockid_t process;
    if (clock_getcpuclockid(plan_.pid, &process) != 0) {throw std::runtime_error("no such process under test");}
    Sent sent;
    sent.stamps.reserve(count);
    sent.late.reserve(count);
    Nanoseconds cpu = 0;
    for (int64_t k = 0; k < warm + count; ++k) {
      const auto due = start + k * period;
      sleep_until(due);
      if (k == warm) {cpu = read_clock(process);}
      const auto late = read_clock(CLOCK_MONOTONIC) - due;
      const auto stamp = publish_position();
      if (k % plan_.current_every == 0) {publish_current(due + period / 2);}
      if (k >= warm) {
        sent.stamps.push_back(stamp);
        sent.late.push_back(late);
      }
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

double share(std::vector<Nanoseconds> & values, double of)
{
  if (values.empty()) {return NAN;}
  const auto at = values.begin() + static_cast<int64_t>(of * (values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at * 1e-3;
}

struct Found
{
  std::vector<Nanoseconds> latencies;
  size_t lost = 0, after_pause = 0;
};

Found compare(const std::vector<Nanoseconds> & stamps, const std::vector<Heard> & heard, const Plan & plan)
{
  std::unordered_map<Nanoseconds, Nanoseconds> received;
  for (const auto & one : heard) {received.emplace(one.stamp, one.at);}
  Found found;
  Nanoseconds before = stamps.empty() ? 0 : stamps.front(), excused_until = 0;
  for (const auto stamp : stamps) {
    if (stamp - before > plan.max_gap_s * SECOND) {excused_until = stamp + std::llround(plan.after_gap_s * SECOND);}
    before = stamp;
    const auto one = received.find(stamp);
    if (one != received.end() && one->second - stamp < GRACE_S * SECOND) {
      found.latencies.push_back(one->second - stamp);
    } else {
      ++(stamp < excused_until ? found.after_pause : found.lost);
    }
  }
  return found;
}

void report(Sent & sent, Found found)
{
  auto & latencies = found.latencies;
  if (latencies.empty()) {throw std::runtime_error("not one estimate was received");}
  std::printf(
    "{\"sent\": %zu, \"lost\": %zu, \"after_pause\": %zu, \"p50_us\": %.1f, \"p99_us\": %.1f, \"max_us\": %.1f, \"cpu_share\": %.5f, "
    "\"late_p50_us\": %.1f, \"late_p99_us\": %.1f}\n",
    sent.stamps.size(), found.lost, found.after_pause, share(latencies, 0.5), share(latencies, 0.99),
    share(latencies, 1.0), sent.cpu_share, share(sent.late, 0.5), share(sent.late, 0.99));
}

Plan declared(rclcpp::Node & node)
{
  return {
    node.declare_parameter("rate_Hz", 1000.0), node.declare_parameter("warm_up_s", 2.0),
    node.declare_parameter("seconds", 5.0), node.declare_parameter("max_gap_s", 0.05),
    node.declare_parameter("after_gap_s", 0.6), static_cast<int>(node.declare_parameter("pid", 0)),
    static_cast<int>(node.declare_parameter("current_every", 1)), node.declare_parameter("current_apart", false)};
}

void measure()
{
  rclcpp::Node node("generator");
  const auto plan = declared(node);
  Generator generator(node, plan);
  Listener listener(node, static_cast<size_t>((plan.warm_up_s + plan.seconds) * plan.rate_Hz * 1.1) + 1000);
  const auto limit = read_clock(CLOCK_MONOTONIC) + 10 * SECOND;
  while (!(generator.is_matched() && listener.is_matched()) && read_clock(CLOCK_MONOTONIC) < limit) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  auto sent = generator.run();
  std::this_thread::sleep_for(std::chrono::duration<double>(GRACE_S));
  report(sent, compare(sent.stamps, listener.end(), plan));
}

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  int status = 0;
  try {
    measure();
  } catch (const std::exception & error) {
    std::fprintf(stderr, "generator: %s\n", error.what());
    status = 1;
  }
  rclcpp::shutdown();
  return status;
}
