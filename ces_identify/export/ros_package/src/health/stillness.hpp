// Rests: how long the position has had exactly the same value, because the vehicle rests or the sensor is stuck.
#ifndef HEALTH__STILLNESS_HPP_
#define HEALTH__STILLNESS_HPP_

#include <cstdint>

#include "core/numbers.hpp"

namespace ces
{

class Stillness
{
public:
  // Rests of at least this long [s] by the positions' stamps count; with 0 there are none.
  void set_warn(double warn_s) {warn_ = to_ns(warn_s);}

  // Add a position sample [m]; NaN ends a rest.
  void take(Nanoseconds stamp, double position_m)
  {
    if (position_m != position_m_ || stamp < since_) {
      position_m_ = position_m;
      since_ = stamp;
      resting_ = false;
    } else if (resting_ || (warn_ > 0 && stamp - since_ >= warn_)) {
      count_ += !resting_;
      resting_ = true;
      last_s_ = to_s(stamp - since_);
    }
  }

  bool is_resting() const {return resting_;}
  std::uint64_t count() const {return count_;}
  double last_s() const {return last_s_;}  // length of the last rest

private:
  Nanoseconds warn_ = SECOND, since_ = 0;
  double position_m_ = NOT_A_NUMBER, last_s_ = 0.0;
  std::uint64_t count_ = 0;
  bool resting_ = false;
};

}  // namespace ces

#endif  // HEALTH__STILLNESS_HPP_
