// Replays a stored sequence of samples to the observer and compares each result with the stored one.
//
// Usage: replay FILE. It prints what differs, and ends with 0 if all is equal to 1e-9 and nothing was allocated
// with finite samples. The lines of the file:
//   settings WAIT_S MAX_AGE_S
//   c STAMP CURRENT NOW, m STAMP MOTION NOW, p STAMP POSITION NOW    samples, and the node's time at their arrival
//   w 0 0 NOW, r 0 0 NOW, s 0 0 NOW                                  watch, time jump, silence
//   d REASON: DETAIL                                                 the expected words at this moment
//   e STAMP FORCE HALF_WIDTH POSITION SPEED                          the expected force, before the x of its position
//   x CLAMPED REASON                                                 the expected count and reason after each position

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <new>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/damper.hpp"
#include "core/intake.hpp"

namespace
{

constexpr double CLOSE = 1e-9;  // relative; absolute below 1
constexpr int MAX_PRINTED = 10;

bool counting = false;
std::uint64_t allocations = 0;

void * allocate(std::size_t size)
{
  allocations += counting;
  void * memory = std::malloc(size == 0 ? 1 : size);
  if (memory == nullptr) {throw std::bad_alloc();}
  return memory;
}

}  // namespace

void * operator new(std::size_t size) {return allocate(size);}
void * operator new[](std::size_t size) {return allocate(size);}
void operator delete(void * memory) noexcept {std::free(memory);}
void operator delete[](void * memory) noexcept {std::free(memory);}
void operator delete(void * memory, std::size_t) noexcept {std::free(memory);}
void operator delete[](void * memory, std::size_t) noexcept {std::free(memory);}

namespace
{

using ces::Nanoseconds;

struct Result
{
  Nanoseconds stamp = 0;
  double force = 0.0, half_width = 0.0, position = 0.0, speed = 0.0;
  bool has_force = false;
  ces::Reason reason = ces::Reason::OK;
  std::uint64_t clamped = 0;
};

// Keeps the results without allocating.
class Results : public ces::EstimateSink
{
public:
  explicit Results(std::size_t most) {results_.reserve(most);}

  void attach(const ces::Damper & damper) {damper_ = &damper;}

  void on_force(Nanoseconds stamp, const std::string &, double force_N) override
  {
    next_.has_force = true;
    next_.stamp = stamp;
    next_.force = force_N;
    next_.half_width = damper_->half_width().value_or(-1.0);
    next_.position = damper_->position();
    next_.speed = damper_->speed();
  }

  void on_processed() override
  {
    next_.reason = damper_->reason();
    next_.clamped = damper_->tally().clamped;
    if (results_.size() < results_.capacity()) {results_.push_back(next_);}
    next_ = Result();
  }

  const std::vector<Result> & all() const {return results_;}

private:
  const ces::Damper * damper_ = nullptr;
  std::vector<Result> results_;
  Result next_;
};

bool is_close(double one, double two)
{
  return std::fabs(one - two) <= CLOSE * std::fmax(1.0, std::fmax(std::fabs(one), std::fabs(two)));
}

bool is_equal(const Result & one, const Result & two)
{
  return one.has_force == two.has_force && one.stamp == two.stamp && one.reason == two.reason &&
         one.clamped == two.clamped && is_close(one.force, two.force) && is_close(one.half_width, two.half_width) &&
         is_close(one.position, two.position) && is_close(one.speed, two.speed);
}

struct Event
{
  char kind = ' ';
  Nanoseconds stamp = 0, now = 0;
  double value = 0.0;
  std::string detail;
};

struct Sequence
{
  double wait_s = 0.0, max_age_s = 0.0;
  std::vector<Event> events;
  std::vector<Result> expected;
};

ces::Reason find_reason(const std::string & text)
{
  for (std::size_t k = 0; k < ces::REASON_TEXTS.size(); ++k) {
    if (text == ces::REASON_TEXTS[k]) {return static_cast<ces::Reason>(k);}
  }
  throw std::runtime_error("unknown reason: " + text);
}

double read_number(std::istringstream & words)
{
  std::string word;
  words >> word;
  return std::strtod(word.c_str(), nullptr);
}

void read_line(const std::string & line, Sequence & sequence, Result & next)
{
  std::istringstream words(line);
  std::string kind;
  words >> kind;
  if (kind == "settings") {
    sequence.wait_s = read_number(words);
    sequence.max_age_s = read_number(words);
  } else if (kind == "e") {
    words >> next.stamp;
    next.has_force = true;
    next.force = read_number(words);
    next.half_width = read_number(words);
    next.position = read_number(words);
    next.speed = read_number(words);
  } else if (kind == "x") {
    words >> next.clamped;
    std::string text;
    std::getline(words >> std::ws, text);
    next.reason = find_reason(text);
    sequence.expected.push_back(next);
    next = Result();
  } else if (kind == "d") {
    Event event;
    event.kind = 'd';
    std::getline(words >> std::ws, event.detail);
    sequence.events.push_back(event);
  } else {
    Event event;
    event.kind = kind.at(0);
    words >> event.stamp;
    event.value = read_number(words);
    words >> event.now;
    sequence.events.push_back(event);
  }
}

Sequence read_sequence(const char * path)
{
  std::ifstream file(path);
  if (!file) {throw std::runtime_error(std::string(path) + ": cannot be read");}
  Sequence sequence;
  Result next;
  for (std::string line; std::getline(file, line); ) {
    if (!line.empty() && line.front() != '#') {read_line(line, sequence, next);}
  }
  if (sequence.expected.empty()) {throw std::runtime_error(std::string(path) + ": no results");}
  return sequence;
}

// Feed the event; return the number of details that differ.
int feed(const Event & event, ces::Damper & damper, ces::Intake & intake)
{
  counting = std::isfinite(event.value) && event.kind != 'd';  // an error text may be allocated for other numbers
  switch (event.kind) {
    case 'c': intake.take_current(event.stamp, event.value, event.now); break;
    case 'm': intake.take_motion(event.stamp, event.value, event.now); break;
    case 'p': intake.take_position(event.stamp, event.value, "chassis", event.now); break;
    case 'w': intake.release(event.now); break;
    case 'r': intake.reset(event.now); break;
    case 's': damper.report_silence(); break;
    case 'd': {
      const auto detail = std::string(ces::text_of(damper.reason())) + ": " + damper.explain();
      if (detail != event.detail) {
        std::printf("detail is '%s', expected '%s'\n", detail.c_str(), event.detail.c_str());
        return 1;
      }
      break;
    }
    default: throw std::runtime_error("unknown event");
  }
  counting = false;
  return 0;
}

void print_result(const char * name, const Result & result)
{
  std::printf(
    "  %s at %lld: %s, %.17g +- %.17g N, %.17g m, %.17g m/s, %llu clamped\n", name,
    static_cast<long long>(result.stamp), ces::text_of(result.reason), result.force, result.half_width, result.position,
    result.speed, static_cast<unsigned long long>(result.clamped));
}

void print_difference(std::size_t place, const Result & found, const Result & expected)
{
  std::printf("result %zu\n", place);
  print_result("found", found);
  print_result("expected", expected);
}

int compare(const std::vector<Result> & found, const std::vector<Result> & expected)
{
  int differing = found.size() == expected.size() ? 0 : 1;
  for (std::size_t k = 0; k < found.size() && k < expected.size(); ++k) {
    if (is_equal(found[k], expected[k])) {continue;}
    if (++differing <= MAX_PRINTED) {print_difference(k, found[k], expected[k]);}
  }
  std::printf("%zu results, %zu expected, %d differ\n", found.size(), expected.size(), differing);
  return differing;
}

ces::SignalHold make_motion()
{
  return *ces::Model::MOTION == '\0' ? ces::SignalHold::constant(0.0) :
         ces::SignalHold::measured(ces::Model::MAX_GAP_S);
}

int replay(const char * path)
{
  const auto sequence = read_sequence(path);
  Results results(sequence.expected.size() + 1);
  ces::Damper damper(
    ces::SignalHold::measured(ces::Model::MAX_CURRENT_AGE_S), make_motion(), sequence.max_age_s);
  results.attach(damper);
  ces::Intake intake(damper, results);
  intake.set_wait(sequence.wait_s);
  int differing = 0;
  for (const auto & event : sequence.events) {differing += feed(event, damper, intake);}
  differing += compare(results.all(), sequence.expected);
  std::printf("%llu allocations with finite samples\n", static_cast<unsigned long long>(allocations));
  return differing == 0 && allocations == 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char ** argv)
{
  if (argc != 2) {
    std::fprintf(stderr, "usage: replay FILE\n");
    return 2;
  }
  try {
    return replay(argv[1]);
  } catch (const std::exception & error) {
    std::fprintf(stderr, "replay: %s\n", error.what());
    return 2;
  }
}
