// A model: what `ces export --out NAME.ces` has written into a flat file, checked.
#pragma once

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/samples.hpp"

namespace ces {

// A mistake of the user, in one line: what is wrong, where, what was expected and what to do.
class UserError : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A measured signal that a model may need beside the position.
enum Motion : std::size_t {NO_MOTION_SIGNAL, SPEED, ACCELERATION};

constexpr const char * MOTIONS[] = {"", "speed", "acceleration"};

// What the core reads of a part of the model, p and n, and the sizes of what it writes, s and k.
struct Arrays {
  std::vector<double> p;
  std::vector<std::int64_t> n;
  std::size_t states = 0, flags = 0;
};

struct Model {
  std::string path, digest, size, outside, claim;  // outside: what becomes of inputs outside the envelope
  bool extrapolates = false, is_proved = false;
  Motion motion = NO_MOTION_SIGNAL;
  double stroke_min_m = 0.0, stroke_max_m = 0.0, delay_s = 0.0, max_gap_s = 0.0, max_current_age_s = 0.0;
  double warm_up_s = 0.0;
  std::size_t delay_ticks = 0;  // of the delayed force; 0: the force comes at once
  Nanoseconds delay = 0;
  Arrays sampling, structure;
};

using ModelPtr = std::shared_ptr<const Model>;

// Read a model; its forces then depend on samples alone, and no sample can lead the core out of its arrays. Raises
// UserError for a file that cannot be used, or whose stability is not proved unless `allow_uncertified`.
ModelPtr read_model(const std::string & path, bool allow_uncertified);

// Whether the core rounds as Python does where this was built; else forces may differ in the last digits.
bool rounds_like_python();

}  // namespace ces
