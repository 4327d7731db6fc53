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

#include <fstream>
#include <new>
#include <sstream>
#include <stdexcept>

#include "core/damper.hpp"

namespace
{

constexpr double CLOSE = 1e-9;  // relative; absolute below 1
constexpr int MAX_PRINTED = 10;
constexpr std::size_t MAX_RELEASED = 100'000;  // positions that one event releases

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

struct Result
{
  ces::Nanoseconds stamp = 0;  // 0: without a force
  std::array<double, 4> numbers{};  // force, half-width or -1, position, speed
  std::uint64_t clamped = 0;
  std::string reason;
};

bool is_equal(const Result & one, const Result & two)
{
  for (std::size_t k = 0; k < one.numbers.size(); ++k) {
    const double a = one.numbers[k], b = two.numbers[k];
    if (!(std::fabs(a - b) <= CLOSE * std::max({1.0, std::fabs(a), std::fabs(b)}))) {return false;}
  }
  return one.stamp == two.stamp && one.clamped == two.clamped && one.reason == two.reason;
}

void print(const char * name, const Result & result)
{
  std::printf("  %s at %lld: %s,", name, static_cast<long long>(result.stamp), result.reason.c_str());
  for (const double number : result.numbers) {std::printf(" %.17g", number);}
  std::printf(" (N, +- N, m, m/s), %llu clamped\n", static_cast<unsigned long long>(result.clamped));
}

double read_number(std::istream & words)
{
  std::string word;
  words >> word;
  return std::strtod(word.c_str(), nullptr);  // nan and inf, too
}

std::string read_rest(std::istream & words)
{
  std::string text;
  std::getline(words >> std::ws, text);
  return text;
}

class Replay
{
public:
  explicit Replay(std::istream & settings)
  : damper_(
      ces::SignalHold(ces::Model::MAX_CURRENT_AGE_S),
      *ces::Model::MOTION ? ces::SignalHold(ces::Model::MAX_GAP_S) : ces::SignalHold(0.0, 0.0))
  {
    found_.reserve(MAX_RELEASED);
    intake_.set_wait(read_number(settings));
    damper_.set_max_age(read_number(settings));
  }

  // Take the line that begins with `kind`.
  void take(char kind, std::istream & words)
  {
    if (kind == 'e') {
      words >> expected_.stamp;
      for (double & number : expected_.numbers) {number = read_number(words);}
    } else if (kind == 'x') {
      words >> expected_.clamped;
      expected_.reason = read_rest(words);
      compare();
    } else if (kind == 'd') {
      const auto expected = read_rest(words), detail = ces::text_of(damper_.reason()) + (": " + damper_.explain());
      if (detail != expected && ++differing_) {
        std::printf("detail is '%s', expected '%s'\n", detail.c_str(), expected.c_str());
      }
    } else {
      finish_event();
      ces::Nanoseconds stamp = 0, now = 0;
      words >> stamp;
      const auto value = read_number(words);
      words >> now;
      counting = std::isfinite(value);  // an error text may be allocated for other numbers
      feed(kind, stamp, value, now);
      counting = false;
    }
  }

  int report()
  {
    finish_event();
    if (expected_count_ == 0) {throw std::runtime_error("no results");}
    std::printf("%d results expected, %d differ\n", expected_count_, differing_);
    std::printf("%llu allocations with finite samples\n", static_cast<unsigned long long>(allocations));
    return differing_ == 0 && allocations == 0 ? 0 : 1;
  }

private:
  void feed(char kind, ces::Nanoseconds stamp, double value, ces::Nanoseconds now)
  {
    switch (kind) {
      case 'c': return intake_.take_current(stamp, value, now);
      case 'm': return intake_.take_motion(stamp, value, now);
      case 'p': return intake_.take_position(stamp, value, "chassis", now);
      case 'w': return intake_.release(now);
      case 'r': return intake_.reset(now);
      case 's': return damper_.report_silence();
      default: throw std::runtime_error(std::string("unknown event ") + kind);
    }
  }

  void on_estimate(ces::Nanoseconds stamp, std::optional<double> force)
  {
    counting = false;  // what is kept for the comparison
    Result result;
    if (force) {
      result.stamp = stamp;
      result.numbers = {*force, damper_.half_width().value_or(-1.0), damper_.position(), damper_.speed()};
    }
    result.clamped = damper_.tally().clamped;
    result.reason = ces::text_of(damper_.reason());
    found_.push_back(result);
    counting = true;
  }

  void compare()
  {
    ++expected_count_;
    if (place_ == found_.size()) {throw std::runtime_error("a result is missing");}
    const auto & found = found_[place_++];
    if (!is_equal(found, expected_) && ++differing_ <= MAX_PRINTED) {
      std::printf("result %d\n", expected_count_);
      print("found", found);
      print("expected", expected_);
    }
    expected_ = Result();
  }

  // Check that all results of the last event were expected.
  void finish_event()
  {
    if (place_ != found_.size()) {throw std::runtime_error("a result was not expected");}
    found_.clear();
    place_ = 0;
  }

  ces::Damper damper_;
  ces::Intake intake_{damper_, [this](ces::Nanoseconds stamp, const std::string &, std::optional<double> force) {
      on_estimate(stamp, force);
    }};
  std::vector<Result> found_;  // by the last event
  std::size_t place_ = 0;  // of the next one to compare
  Result expected_;
  int expected_count_ = 0, differing_ = 0;
};

int replay(const std::string & path)
{
  std::ifstream file(path);
  std::string word;
  if (!(file >> word) || word != "settings") {throw std::runtime_error("cannot be read, or is no sequence");}
  Replay replay(file);
  std::string line;
  while (std::getline(file >> std::ws, line)) {
    std::istringstream words(line.substr(1));
    replay.take(line.front(), words);
  }
  return replay.report();
}

}  // namespace

int main(int argc, char ** argv)
{
  const char * path = argc == 2 ? argv[1] : "test/sequence.txt";
  try {
    return replay(path);
  } catch (const std::exception & error) {
    std::fprintf(stderr, "replay: %s: %s\n", path, error.what());
    return 2;
  }
}
