// Why a force is published or withheld, in the words of /diagnostics.
#ifndef CORE__REASON_HPP_
#define CORE__REASON_HPP_

#include <array>
#include <cstddef>

namespace ces
{

// The first six are the reasons of the compiled model, in its order.
enum class Reason : std::size_t
{
  OK,
  WARMING_UP,
  NOT_FINITE,
  OUT_OF_ORDER,
  OUTLIER,
  UNBOUNDED,
  SILENT,
  POSITION_NOT_FINITE,
  NO_CURRENT,
  NO_MOTION,
  OFF_CLOCK,
};

constexpr std::array<const char *, 11> REASON_TEXTS{
  "ok",
  "warming up",
  "position or current is not finite",
  "stamp repeats or runs backwards",
  "position is an outlier",
  "force left its envelope",
  "no position samples arrive",
  "position is not finite",
  "no usable current",
  "no usable speed or acceleration",
  "position stamps are off the node's clock",
};

constexpr const char * text_of(Reason reason) {return REASON_TEXTS[static_cast<std::size_t>(reason)];}

// A number for each reason.
template<typename T>
class ByReason
{
public:
  T & operator[](Reason reason) {return values_[static_cast<std::size_t>(reason)];}
  const T & operator[](Reason reason) const {return values_[static_cast<std::size_t>(reason)];}

private:
  std::array<T, REASON_TEXTS.size()> values_{};
};

}  // namespace ces

#endif  // CORE__REASON_HPP_
