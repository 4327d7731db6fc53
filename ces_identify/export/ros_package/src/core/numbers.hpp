// Times as whole nanoseconds, and numbers as text.
#ifndef CORE__NUMBERS_HPP_
#define CORE__NUMBERS_HPP_

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <string>

namespace ces
{

using Nanoseconds = std::int64_t;

constexpr Nanoseconds SECOND = 1'000'000'000;
constexpr double NOT_A_NUMBER = std::numeric_limits<double>::quiet_NaN();

inline Nanoseconds to_ns(double seconds) {return static_cast<Nanoseconds>(std::nearbyint(seconds * 1e9));}

inline double to_s(Nanoseconds time) {return static_cast<double>(time) * 1e-9;}

// The text of a format for one number, such as "%.3g".
inline std::string format_number(const char * format, double value)
{
  char text[400];  // "%.1f" of the largest double has 311 characters
  std::snprintf(text, sizeof text, format, value);
  return text;
}

// A number for messages; the sign of NaN is not shown.
inline std::string format_value(double value) {return std::isnan(value) ? "nan" : format_number("%g", value);}

}  // namespace ces

#endif  // CORE__NUMBERS_HPP_
