// Replays a stored sequence of samples to the observer and compares each result with the stored one.
//
// Usage: replay FILE. It prints what differs, and ends with 0 if all is equal to 1e-9 and nothing was allocated
// with finite samples. The lines of the file:
//   settings WAIT_S MAX_AGE_S
//   c STAMP CURRENT NOW, m STAMP MOTION NOW, p STAMP POSITION NOW    samples, and the node's time at their arrival
//   w 0 0 NOW, r 0 0 NOW, s 0 0 NOW                                  watch, time jump, silence
//   d REASON: DETAIL                                                 the expected words at this moment
//   e STAMP POSITION SPEED FORCE HALF_WIDTH                          the expected force, before the x of its position
//   l STAMP POSITION SPEED FORCE HALF_WIDTH                          that of an earlier sample, from a model with a delay
//   x CLAMPED HELD LATE REASON                                       the expected counts and reason after each position

#include <fstream>
#include <new>
#include <sstream>
#include <stdexcept>

#include "core/damper.hpp"

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

// Whether two lines of results have the same words, and close numbers in the last columns of an estimate.
bool is_equal(const std::string & one, const std::string & two)
{
  std::istringstream ones(one), twos(two);
  std::string a, b;
  for (int column = 0; ones >> a; ++column) {
    if (!(twos >> b)) {return false;}
    const double x = std::strtod(a.c_str(), nullptr), y = std::strtod(b.c_str(), nullptr);
    const bool is_close = std::fabs(x - y) <= CLOSE * std::max({1.0, std::fabs(x), std::fabs(y)});
    if (column < 2 || one.front() == 'x' ? a != b : !is_close) {return false;}
  }
  return !(twos >> b);
}

std::string describe(char kind, const ces::Estimate & one)
{
  const double width = std::isfinite(one.half_width) ? one.half_width : -1.0;
  std::string line = kind + (" " + std::to_string(one.stamp));
  for (const double number : {one.position, one.speed, one.force, width}) {
    line += ces::format_number(" %.17g", number);
  }
  return line;
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
    intake_.set_wait(read_number(settings));
    damper_.set_max_age(read_number(settings));
  }

  // Take the line that begins with `kind`.
  void take(char kind, std::istream & words)
  {
    if (kind == 'e' || kind == 'l' || kind == 'x') {
      compare(kind + (" " + read_rest(words)));
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
    if (force) {
      const ces::Estimate now{stamp, damper_.position(), damper_.speed(), *force, damper_.half_width()};
      found_.push_back(describe('e', now));
    }
    for (const auto & one : damper_.late()) {found_.push_back(describe('l', one));}
    std::string line = "x";
    const auto & tally = damper_.tally();
    for (const auto count : {tally.clamped, tally.held, tally.late}) {line += " " + std::to_string(count);}
    found_.push_back(line + " " + ces::text_of(damper_.reason()));
    counting = true;
  }

  void compare(const std::string & expected)
  {
    ++expected_count_;
    if (place_ == found_.size()) {throw std::runtime_error("a result is missing");}
    const auto & found = found_[place_++];
    if (!is_equal(found, expected) && ++differing_ <= MAX_PRINTED) {
      std::printf("result %d\n  found %s\n  expected %s\n", expected_count_, found.c_str(), expected.c_str());
    }
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
  std::vector<std::string> found_;  // lines, by the last event
  std::size_t place_ = 0;  // of the next one to compare
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
