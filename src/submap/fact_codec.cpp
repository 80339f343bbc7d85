#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_codec.hpp>
#include <convoy/submap/fact_fields.hpp>

#include <algorithm>
#include <bit>

namespace convoy {
namespace {

constexpr std::size_t bytes_per_key = 16;

/// Archives of fact_fields.hpp. Matrices and arrays that are all zero, bit for bit, take one byte.
class WritingArchive {
 public:
  explicit WritingArchive(Bytes& out) : out_(out) {}

  template <class Number>
  void natural(Number value, int bytes) {
    const auto number = static_cast<std::uint64_t>(value);
    for (int i = 0; i < bytes; ++i) out_.push_back(static_cast<std::uint8_t>(number >> (8 * i)));
  }
  void real(double value) { natural(std::bit_cast<std::uint64_t>(value), 8); }
  template <class Matrix>
  void matrix(const Matrix& m) {
    const bool any =
        std::any_of(m.data(), m.data() + m.size(), [](double x) { return std::bit_cast<std::uint64_t>(x); });
    natural(any, 1);
    if (any)
      for (Eigen::Index i = 0; i < m.size(); ++i) real(m.data()[i]);
  }
  void pose(const SE2& T) {
    matrix(T.translation());
    real(T.theta());
  }
  void pose(const SE3& T) {
    matrix(T.translation());
    matrix(T.quaternion());
  }
  template <std::size_t N>
  void bytes(const std::array<std::uint8_t, N>& array) {
    const bool any = std::any_of(array.begin(), array.end(), [](std::uint8_t b) { return b != 0; });
    natural(any, 1);
    if (any) out_.insert(out_.end(), array.begin(), array.end());
  }
  template <class Item, class Visit>
  void list(const std::vector<Item>& items, const Visit& visit) {
    natural(items.size(), 4);
    for (const Item& item : items) visit(item);
  }

 private:
  Bytes& out_;
};

class ReadingArchive {
 public:
  explicit ReadingArchive(std::span<const std::uint8_t> in) : in_(in) {}
  bool whole() const { return ok_ && in_.empty(); }

  template <class Number>
  void natural(Number& value, int bytes) {
    std::uint64_t number = 0;
    for (int i = 0; i < bytes; ++i) number |= std::uint64_t{next()} << (8 * i);
    value = static_cast<Number>(number);
  }
  void real(double& value) {
    std::uint64_t bits = 0;
    natural(bits, 8);
    value = std::bit_cast<double>(bits);
  }
  template <class Matrix>
  void matrix(Matrix& m) {
    m.setZero();
    if (next() != 0)
      for (Eigen::Index i = 0; i < m.size(); ++i) real(m.data()[i]);
  }
  void pose(SE2& T) {
    SE2::Point t;
    double theta = 0.0;
    matrix(t);
    real(theta);
    T = {t.x(), t.y(), theta};
  }
  void pose(SE3& T) {
    SE3::Point t;
    SE3::Quaternion q;
    matrix(t);
    matrix(q);
    T = {q, t};
  }
  template <std::size_t N>
  void bytes(std::array<std::uint8_t, N>& array) {
    array.fill(0);
    if (next() != 0)
      for (std::uint8_t& byte : array) byte = next();
  }
  template <class Item, class Visit>
  void list(std::vector<Item>& items, const Visit& visit) {
    std::uint32_t size = 0;
    natural(size, 4);
    ok_ = ok_ && size <= in_.size() / (2 * bytes_per_key);  // nothing is reserved for items that are not there
    if (!ok_) return;
    items.resize(size);
    for (Item& item : items) visit(item);
  }

 private:
  std::uint8_t next() {
    ok_ = ok_ && !in_.empty();
    if (!ok_) return 0;
    const std::uint8_t byte = in_.front();
    in_ = in_.subspan(1);
    return byte;
  }
  std::span<const std::uint8_t> in_;
  bool ok_ = true;
};

template <class G, std::size_t kind = 0>
std::optional<AnyFact<G>> decode_kind(std::size_t wanted, std::span<const std::uint8_t> bytes) {
  if constexpr (kind == std::variant_size_v<AnyFact<G>>) {
    return std::nullopt;
  } else {
    if (wanted != kind) return decode_kind<G, kind + 1>(wanted, bytes);
    std::variant_alternative_t<kind, AnyFact<G>> fact;
    ReadingArchive archive(bytes);
    fact_fields(archive, fact);
    if (!archive.whole()) return std::nullopt;
    return fact;
  }
}

}  // namespace

template <class G>
void encode(const AnyFact<G>& fact, Bytes& out) {
  out.push_back(static_cast<std::uint8_t>(fact.index()));
  WritingArchive archive(out);
  std::visit([&](const auto& f) { fact_fields(archive, f); }, fact);
}

template <class G>
std::optional<AnyFact<G>> decode(std::span<const std::uint8_t> bytes) {
  if (bytes.empty()) return std::nullopt;
  return decode_kind<G>(bytes.front(), bytes.subspan(1));
}

#define CONVOY_INSTANTIATE(G)                         \
  template void encode<G>(const AnyFact<G>&, Bytes&); \
  template std::optional<AnyFact<G>> decode<G>(std::span<const std::uint8_t>);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
