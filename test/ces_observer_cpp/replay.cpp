// Feeds a sequence of samples to the observer as the node does, and prints each result.
//
// Usage: replay MODEL SEQUENCE. With finite samples nothing may be allocated; the last line says how often it was.
// The lines of a sequence, with the node's time:
//   settings WAIT_S MAX_AGE_S
//   c STAMP CURRENT NOW, v STAMP SPEED NOW, a STAMP ACCELERATION NOW, p STAMP POSITION NOW    a sample
//   w 0 0 NOW, r 0 0 NOW, s 0 0 NOW, d 0 0 NOW    watch, time jump, silence, print the reason with its details
//   n 0 0 NOW MODEL                               another model
// The lines of a result:
//   e STAMP POSITION SPEED FORCE HALF_WIDTH      a force; before the x of its position
//   l STAMP POSITION SPEED FORCE HALF_WIDTH      that of an earlier sample, from a model with a delay
//   x CLAMPED HELD LATE DIGEST REASON            counts, model and reason after each position
//   d REASON: DETAIL

#include <fstream>
#include <iostream>
#include <new>
#include <sstream>

#include "core/damper.hpp"

namespace {

bool counting = false;
std::uint64_t allocations = 0;

void * allocate(std::size_t size) {
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

namespace {

void print(char kind, const ces::Estimate & one) {
  std::printf(
    "%c %lld %.17g %.17g %.17g %.17g\n", kind, static_cast<long long>(one.stamp), one.position, one.speed, one.force,
    std::isfinite(one.half_width) ? one.half_width : -1.0);
}

class Replay {
public:
  Replay(const std::string & model, double wait_s, double max_age_s)
  : damper_(ces::read_model(model, true), ces::SignalHold(), {std::nullopt, ces::SignalHold(), ces::SignalHold()}) {
    intake_.set_wait(wait_s);
    damper_.set_max_age(max_age_s);
  }

  void take(const std::string & line) {
    std::istringstream words(line);
    char kind = 0;
    ces::Nanoseconds stamp = 0, now = 0;
    std::string number, model;
    words >> kind >> stamp >> number >> now >> model;
    const double value = std::strtod(number.c_str(), nullptr);  // nan and inf, too
    if (kind == 'd') {
      std::printf("d %s: %s\n", ces::text_of(damper_.reason()), damper_.explain().c_str());
    } else if (kind == 'n') {
      damper_.load(ces::read_model(model, true));
    } else {
      counting = std::isfinite(value);  // an error text may be allocated for other numbers
      feed(kind, stamp, value, now);
      counting = false;
    }
  }

private:
  void feed(char kind, ces::Nanoseconds stamp, double value, ces::Nanoseconds now) {
    switch (kind) {
      case 'c': return intake_.take_current(stamp, value, now);
      case 'v': return intake_.take_motion(ces::SPEED, stamp, value, now);
      case 'a': return intake_.take_motion(ces::ACCELERATION, stamp, value, now);
      case 'p': return intake_.take_position(stamp, value, "chassis", now);
      case 'w': return intake_.release(now);
      case 'r': return intake_.reset(now);
      case 's': return damper_.report_silence();
      default: throw ces::UserError(std::string("unknown event ") + kind);
    }
  }

  void on_estimate(ces::Nanoseconds stamp, std::optional<double> force) {
    if (force) {print('e', {stamp, damper_.position(), damper_.speed(), *force, damper_.half_width()});}
    for (const auto & one : damper_.late()) {print('l', one);}
    const auto & tally = damper_.tally();
    std::printf(
      "x %llu %llu %llu %.8s %s\n", static_cast<unsigned long long>(tally.clamped),
      static_cast<unsigned long long>(tally.held), static_cast<unsigned long long>(tally.late),
      damper_.model().digest.c_str(), ces::text_of(damper_.reason()));
  }

  ces::Damper damper_;
  ces::Intake intake_{damper_, [this](ces::Nanoseconds stamp, const std::string &, std::optional<double> force) {
      on_estimate(stamp, force);
    }};
};

}  // namespace

int main(int argc, char ** argv) {
  static char buffer[1 << 16];  // printing allocates nothing
  std::setvbuf(stdout, buffer, _IOFBF, sizeof buffer);
  try {
    std::ifstream file(argc == 3 ? argv[2] : "");
    std::string word, line;
    double wait_s = 0.0, max_age_s = 0.0;
    if (!(file >> word >> wait_s >> max_age_s >> std::ws)) {throw ces::UserError("usage: replay MODEL SEQUENCE");}
    Replay replay(argv[1], wait_s, max_age_s);
    while (std::getline(file, line)) {replay.take(line);}
    if (!ces::rounds_like_python()) {throw ces::UserError("the core rounds otherwise than Python");}
    std::printf("%llu allocations with finite samples\n", static_cast<unsigned long long>(allocations));
    return 0;
  } catch (const ces::UserError & error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
