// The layout, little endian: "CES-FLAT", version, length of the text; lines key=value, filled up to 8 bytes with zeros;
// for sampling and structure: sizes of p, n, s and k, then p and n; CRC-32 of all before. `ces_identify/export/
// export_model.py` writes it.
#include "model/flat_file.hpp"

#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <map>
#include <sstream>

#include "ces_core.h"
#include "from_python.hpp"

namespace ces {
namespace {

static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__ && sizeof(double) == 8);

constexpr std::streamoff MAX_BYTES = 16 << 20;
constexpr std::size_t HEAD_BYTES = 16, CRC_BYTES = 4;
constexpr std::uint32_t VERSION = 2;
constexpr const char * AGAIN = "; copy it again, or write it with `ces export model.json --out NAME.ces`";

std::uint32_t crc32(const std::string & bytes, std::size_t count) {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t i = 0; i < table.size(); ++i) {
    table[i] = i;
    for (int bit = 0; bit < 8; ++bit) {table[i] = table[i] >> 1 ^ (table[i] & 1 ? 0xEDB88320u : 0u);}
  }
  std::uint32_t crc = ~0u;
  for (std::size_t k = 0; k < count; ++k) {crc = crc >> 8 ^ table[(crc ^ static_cast<unsigned char>(bytes[k])) & 0xFF];}
  return ~crc;
}

class FlatFile {
public:
  explicit FlatFile(const std::string & path)
  : path_(path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file) {refuse(errno == ENOENT ? "no such model file" : "cannot be read; check its permissions", "");}
    const auto size = static_cast<std::streamoff>(file.tellg());
    if (size > MAX_BYTES) {refuse("has more than 16 MiB, or is a folder; expected a model file", "");}
    bytes_.resize(static_cast<std::size_t>(std::max(size, std::streamoff(0))));
    file.seekg(0).read(bytes_.data(), static_cast<std::streamsize>(bytes_.size()));
  }

  ModelPtr read(bool allow_uncertified) {
    open();
    auto model = std::make_shared<Model>();
    model->path = path_;
    read_text(*model);
    read_arrays(model->sampling, "sampling");
    read_arrays(model->structure, "structure");
    if (at_ != end_) {refuse("has " + std::to_string(end_ - at_) + " bytes too many");}
    check(*model);
    if (!model->is_proved && !allow_uncertified) {
      refuse("its stability is not proved",
        "; identify it again with a certificate, or set allow_uncertified: true to run it without");
    }
    return model;
  }

private:
  [[noreturn]] void refuse(const std::string & what, const std::string & remedy = AGAIN) const {
    throw UserError(path_ + ": " + what + remedy);
  }

  // Check the frame around the numbers, and find the texts.
  void open() {
    if (bytes_.size() < HEAD_BYTES + CRC_BYTES || bytes_.compare(0, 8, "CES-FLAT")) {refuse("is no flat model file");}
    end_ = bytes_.size() - CRC_BYTES;
    if (const auto version = load<std::uint32_t>(8); version != VERSION) {
      refuse("has version " + std::to_string(version) + " of the format; expected " + std::to_string(VERSION));
    }
    if (load<std::uint32_t>(end_) != crc32(bytes_, end_)) {refuse("its checksum is wrong, it is damaged or cut off");}
    const std::size_t length = load<std::uint32_t>(12);
    if (length > end_ - HEAD_BYTES) {refuse("its text is longer than the file");}
    std::istringstream lines(bytes_.substr(HEAD_BYTES, length));
    for (std::string key, value; std::getline(lines, key, '=') && std::getline(lines, value); ) {texts_[key] = value;}
    at_ = (HEAD_BYTES + length + 7) / 8 * 8;
  }

  void read_text(Model & model) const {
    if (const auto & core = text("core"); core != CORE_DIGEST) {
      refuse("was written for the core " + core.substr(0, 16) + ", this node has " + CORE_DIGEST,
        "; write it with `ces export` of the ces_observer that this was built from, or build this package again");
    }
    model.digest = text("model");
    model.size = text("size");
    model.outside = text("outside");
    model.claim = text("claim");
    model.extrapolates = number("extrapolates") != 0.0;
    model.is_proved = number("proved") != 0.0;
    model.stroke_min_m = number("stroke_min_m");
    model.stroke_max_m = number("stroke_max_m");
    model.delay_s = number("delay_s");
    model.max_gap_s = number("max_gap_s");
    model.max_current_age_s = number("max_current_age_s");
    const auto * motion = std::find(std::begin(MOTIONS), std::end(MOTIONS), text("motion"));
    if (motion == std::end(MOTIONS)) {refuse("motion is '" + text("motion") + "', which is not known");}
    model.motion = static_cast<Motion>(motion - std::begin(MOTIONS));
  }

  const std::string & text(const std::string & key) const {
    const auto found = texts_.find(key);
    if (found == texts_.end()) {refuse("has no '" + key + "'");}
    return found->second;
  }

  double number(const std::string & key) const {
    const auto & value = text(key);
    char * rest = nullptr;
    const double number = std::strtod(value.c_str(), &rest);
    if (value.empty() || *rest || !std::isfinite(number)) {refuse(key + " is '" + value + "'; expected a number");}
    return number;
  }

  template<typename T>
  T load(std::size_t at) const {
    T value;
    std::memcpy(&value, bytes_.data() + at, sizeof value);
    return value;
  }

  template<typename T>
  std::vector<T> load_many(std::size_t count) {
    std::vector<T> values(count);
    if (count) {std::memcpy(values.data(), bytes_.data() + at_, count * sizeof(T));}
    at_ += count * sizeof(T);
    return values;
  }

  void read_arrays(Arrays & arrays, const std::string & name) {
    if (at_ > end_ || end_ - at_ < 32) {refuse(name + " is missing");}
    const auto sizes = load_many<std::int64_t>(4);
    for (const auto size : sizes) {
      if (size < 0 || size > MAX_BYTES / 8) {refuse(name + " has a size of " + std::to_string(size));}
    }
    const auto numbers = static_cast<std::size_t>(sizes[0]), counts = static_cast<std::size_t>(sizes[1]);
    if (numbers + counts > (end_ - at_) / 8) {refuse(name + " is longer than the file");}
    arrays.p = load_many<double>(numbers);
    arrays.n = load_many<std::int64_t>(counts);
    arrays.states = static_cast<std::size_t>(sizes[2]);
    arrays.flags = static_cast<std::size_t>(sizes[3]);
    for (std::size_t i = 0; i < numbers; ++i) {
      if (std::isfinite(arrays.p[i])) {continue;}
      refuse(name + ": number " + std::to_string(i) + " is " + format_number("%g", arrays.p[i]),
        "; expected finite numbers: identify the model again");
    }
  }

  // Let the core check sizes and indices, and find what depends on them.
  void check(Model & model) const {
    const auto & a = model.sampling, & b = model.structure;
    const auto size = [](std::size_t count) {return static_cast<std::int64_t>(count);};
    const bool fits = ces_check_model(
      a.p.data(), a.n.data(), size(a.p.size()), size(a.n.size()), size(a.states), size(a.flags),
      b.p.data(), b.n.data(), size(b.p.size()), size(b.n.size()), size(b.states), size(b.flags));
    if (!fits) {refuse("its sizes and indices do not fit together");}
    model.delay_ticks = static_cast<std::size_t>(a.n[CES_DELAY]);
    model.delay = to_ns(static_cast<double>(model.delay_ticks) / b.p[CES_RATE]);
    model.warm_up_s = static_cast<double>(b.n[CES_WARM_UP]) / b.p[CES_RATE];
  }

  std::string path_, bytes_;
  std::map<std::string, std::string> texts_;
  std::size_t at_ = 0, end_ = 0;
};

}  // namespace

ModelPtr read_model(const std::string & path, bool allow_uncertified) {return FlatFile(path).read(allow_uncertified);}

bool rounds_like_python() {
  bool is_same = true;
  for (std::size_t i = 0; i < std::size(ROUNDED); ++i) {
    is_same = is_same && ces_rounding_sample(static_cast<std::int64_t>(i) + 1) == ROUNDED[i];
  }
  return is_same;
}

}  // namespace ces
