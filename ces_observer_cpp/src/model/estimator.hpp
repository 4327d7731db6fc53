// The estimator of one damper: samples in; the force of a model, or the reason why it has none, out. The arithmetic is
// the compiled core's, printed from ces_observer/tick.
#pragma once

#include "ces_core.h"
#include "from_python.hpp"
#include "model/flat_file.hpp"


namespace ces {

// The estimate at a sample [m, m/s, N]; `half_width` [N] is not finite without a band.
struct Estimate {
  Nanoseconds stamp;
  double position, speed, force, half_width;
};

class Estimator {
  // Call a function of the core with all arrays before its other arguments.
  template<typename Function, typename... Values>
  auto call(Function function, Values... values) {
    const auto & m = *model_;
    return function(
      m.sampling.p.data(), m.sampling.n.data(), sampling_.s.data(), sampling_.k.data(),
      m.structure.p.data(), m.structure.n.data(), structure_.s.data(), structure_.k.data(), values...);
  }

public:
  // It holds the model; nothing is allocated later.
  explicit Estimator(ModelPtr model)
  : model_(std::move(model)), sampling_(model_->sampling), structure_(model_->structure) {reset();}

  void reset() {call(ces_estimator_reset);}

  // The force [N] at `stamp`, or nothing with `reason` set; a model with a delay has none, and the reason is OK.
  std::optional<double> step(Nanoseconds stamp, double position_m, double current_A, double motion) {
    const bool is_ok = call(ces_estimator_step, stamp, position_m, current_A, motion) == CES_OK;
    return is_ok && !model_->delay_ticks ? std::optional<double>(sampling_.s[CES_FORCE]) : std::nullopt;
  }

  // Call `visit` with each estimate of an earlier sample that the last step has brought.
  template<typename Visit>
  void visit_late(const Visit & visit) const {
    const auto * values = &sampling_.s[index(model_->sampling.n[CES_LATE_VALUES])];
    const auto * stamps = &sampling_.k[index(model_->sampling.n[CES_LATE_STAMPS])];
    for (std::int64_t i = 0; i < late_count(); ++i, values += CES_LATE_WIDTH) {
      visit(Estimate{stamps[i], values[0], values[1], values[2], values[3]});
    }
  }

  // Give no late estimates up to this stamp: another estimator has given them.
  void skip_late(Nanoseconds until) {
    ces_estimator_skip_late(model_->sampling.n.data(), sampling_.s.data(), sampling_.k.data(), until);
  }

  const ModelPtr & model() const {return model_;}
  Reason reason() const {return static_cast<Reason>(sampling_.k[CES_REASON]);}
  // Whether `step` has just given a force, at once or of an earlier sample.
  bool is_warm() const {return reason() == Reason::OK && (!model_->delay_ticks || late_count() > 0);}
  // What a warm-up is for.
  const char * cause() const {return sampling_.k[CES_CAUSE] ? REASON_TEXTS[index(sampling_.k[CES_CAUSE])] : "";}
  double position() const {return sampling_.s[CES_TRACK_POSITION];}
  double speed() const {return sampling_.s[CES_TRACK_SPEED];}
  bool is_clamped() const {return structure_.k[CES_CLAMPED] != 0;}
  bool is_held() const {return structure_.k[CES_HELD] != 0;}

  // The half-width [N] of the band around the force of the last step; not finite without a band.
  double half_width() const {
    const auto & m = model_->structure;
    return model_->delay_ticks ? NOT_A_NUMBER : ces_run_half_width(m.p.data(), m.n.data(), structure_.s.data());
  }

private:
  struct State {
    explicit State(const Arrays & arrays)
    : s(arrays.states), k(arrays.flags) {}
    std::vector<double> s;
    std::vector<std::int64_t> k;
  };

  static std::size_t index(std::int64_t place) {return static_cast<std::size_t>(place);}

  std::int64_t late_count() const {return sampling_.k[CES_LATE_COUNT];}

  ModelPtr model_;
  State sampling_, structure_;
};

}  // namespace ces
