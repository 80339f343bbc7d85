// Association problems on made-up streets: facades whose windows repeat, lamp posts, and things that stand anywhere.
// New landmarks of one or several batches in a row, seen from a vehicle that drives along the first street and drifts,
// and a map around them that holds a share of them. As many of every kind as among the recorded problems.
#pragma once

#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <numbers>
#include <utility>
#include <vector>

#include "../unit/random_world.hpp"
#include "association_problems.hpp"

namespace convoy::bench {

enum class Layout : std::uint8_t { straight, ell, curve, tee };

struct StreetProblemParams {
  Layout layout = Layout::straight;
  int fresh = 0, mapped = 0;  ///< landmarks
  double overlap = 0.0;       ///< share of the new landmarks that the map holds; 0: the map is of another place
  bool one_stretch = false;   ///< what is in common lies on one stretch of the way
  double sigma_m = 0.0;       ///< of a landmark, about
  double regularity = 0.0;    ///< share of the windows that are landmarks
  double way_m = 0.0;         ///< that is driven
  double heading_deg = 20.0;  ///< 95 % of the prior; of the position: 22 m
  bool signatures = false;    ///< landmarks say what they look like
  std::uint64_t seed = 0;
};

/// The middle of a street, by the way along it [m].
class Street {
 public:
  explicit Street(std::vector<Eigen::Vector2d> corners) : corners_(std::move(corners)), way_m_{0.0} {
    for (std::size_t k = 1; k < corners_.size(); ++k)
      way_m_.push_back(way_m_.back() + (corners_[k] - corners_[k - 1]).norm());
  }
  double length_m() const { return way_m_.back(); }
  /// Heading along the street; beyond its ends: at them.
  SE2 at(double s_m) const {
    s_m = std::clamp(s_m, 0.0, length_m());
    const auto next = std::upper_bound(way_m_.begin() + 1, way_m_.end() - 1, s_m);
    const auto k = static_cast<std::size_t>(next - way_m_.begin());
    const Eigen::Vector2d along = (corners_[k] - corners_[k - 1]).normalized();
    const Eigen::Vector2d p = corners_[k - 1] + (s_m - way_m_[k - 1]) * along;
    return {p.x(), p.y(), std::atan2(along.y(), along.x())};
  }

 private:
  std::vector<Eigen::Vector2d> corners_;
  std::vector<double> way_m_;
};

/// Of about this length; the vehicle drives along the first.
inline std::vector<Street> streets(Layout layout, double length_m) {
  const double L = length_m;
  const Eigen::Vector2d origin(0.0, 0.0);
  if (layout == Layout::ell) return {Street({origin, {0.45 * L, 0.0}, {0.45 * L, 0.55 * L}})};
  if (layout == Layout::tee) return {Street({origin, {0.6 * L, 0.0}}), Street({{0.3 * L, 8.0}, {0.3 * L, 0.4 * L}})};
  if (layout == Layout::straight) return {Street({origin, {L, 0.0}})};
  std::vector<Eigen::Vector2d> arc;
  constexpr double turn_rad = 1.2;
  for (int k = 0; k <= 40; ++k) {
    const double angle = turn_rad * k / 40.0;
    arc.push_back(L / turn_rad * Eigen::Vector2d(std::sin(angle), 1.0 - std::cos(angle)));
  }
  return {Street(arc)};
}

/// A thing beside a street, which may become a landmark.
struct Thing {
  Eigen::Vector3d place;  // [m], height last; 0 in the plane
  std::size_t street;
  double s_m;
  std::uint64_t signature;  // what it looks like; windows alike are nearly the same
};

/// What the streets of one town have in common.
class TownStyle {
 public:
  TownStyle(test::Random& random, double regularity, bool in_space)
      : regularity_(regularity),
        in_space_(in_space),
        half_width_m_(random.uniform(6.5, 10.0)),
        apart_m_(1.0 / (random.uniform(0.8, 1.1) * (1.25 - regularity))),
        roughness_m_(0.6 * (1.0 - regularity)) {
    for (Windows& w : windows_) {
      w = {2.4 + 0.3 * random.integer(0, 4), 1.0 + 0.2 * random.integer(0, 2), {}};
      for (std::uint64_t& corner : w.corners) corner = random.engine()();
    }
    pole_ = random.engine()();
  }

  std::vector<Thing> things(test::Random& random, const std::vector<Street>& streets) const {
    std::vector<Thing> all;
    for (std::size_t k = 0; k < streets.size(); ++k)
      for (const double side : {-1.0, 1.0}) {
        const auto put = [&](double s_m, double aside_m, double height_m, std::uint64_t signature) {
          if (s_m >= streets[k].length_m()) return;
          const SE2::Point p = streets[k].at(s_m) * SE2::Point(0.0, side * aside_m);
          all.push_back({{p.x(), p.y(), in_space_ ? height_m : 0.0}, k, s_m, signature});
        };
        const double length_m = streets[k].length_m();
        for (double s = random.uniform(0.0, 4.0); s < length_m;) s += facade(random, s, put);
        for (double s = random.uniform(0.0, 20.0); s < length_m; s += 24.0 + random.normal(0.4))
          lamp_post(random, s, put);
        for (double s = anywhere(random); s < length_m; s += anywhere(random))
          put(s, half_width_m_ + random.uniform(-5.0, 2.5), random.uniform(0.0, 6.0), random.engine()());
      }
    return all;
  }

 private:
  struct Windows {
    double pitch_m, width_m;
    std::array<std::uint64_t, 4> corners;  // signatures: low left, low right, high left, high right
  };

  // From s on; the edges of its windows are things. Returns how much of the street it takes. [m]
  template <class Put>
  double facade(test::Random& random, double s, const Put& put) const {
    const Windows& w = windows_[static_cast<std::size_t>(random.integer(0, 1))];
    const int columns = random.integer(3, 6), storeys = in_space_ ? 3 : 1;
    const double front_m = half_width_m_ + random.normal(0.35);
    for (int column = 0; column < columns; ++column)
      for (int storey = 0; storey < storeys; ++storey)
        for (const double edge : {-0.5, 0.5}) {
          if (random.uniform(0.0, 1.0) > regularity_) continue;
          const double at_m = s + w.pitch_m * (column + 0.5) + edge * w.width_m;
          const double aside_m = front_m + random.normal(roughness_m_);
          const std::size_t right = edge > 0.0 ? 1 : 0;
          put(at_m, aside_m, 3.0 * storey + 1.0, varied(random, w.corners[right], 3));
          if (in_space_) put(at_m, aside_m, 3.0 * storey + 2.3, varied(random, w.corners[2 + right], 3));
        }
    constexpr std::array<double, 4> gaps_m{0.0, 0.0, 1.5, 3.0};
    return w.pitch_m * columns + gaps_m[static_cast<std::size_t>(random.integer(0, 3))];
  }

  template <class Put>
  void lamp_post(test::Random& random, double s, const Put& put) const {
    const double aside_m = half_width_m_ - 2.2 + random.normal(0.1);
    put(s, aside_m, 2.0, varied(random, pole_, 1));
    if (in_space_) put(s, aside_m, 5.0, varied(random, pole_, 1));
  }

  static std::uint64_t varied(test::Random& random, std::uint64_t signature, int bits) {
    for (; bits > 0; --bits) signature ^= std::uint64_t{1} << random.integer(0, 63);
    return signature;
  }

  double anywhere(test::Random& random) const { return -apart_m_ * std::log(1.0 - random.uniform(0.0, 1.0)); }

  double regularity_;
  bool in_space_;
  double half_width_m_;
  double apart_m_;  // things that stand anywhere, on each side
  double roughness_m_;
  std::array<Windows, 2> windows_;
  std::uint64_t pole_ = 0;
};

/// Makes one problem.
template <class G>
class StreetProblem {
 public:
  explicit StreetProblem(const StreetProblemParams& params)
      : params_(params), random_(params.seed), prior_error_(draw_prior_error()), way_m_(params.way_m) {
    T_map_world_ = SE2(0.0, 0.0, random_.uniform(-std::numbers::pi, std::numbers::pi));
    build();
    choose_way();
    choose_landmarks();
    drive();
  }

  KnownProblem make() {
    AssociationProblem<G> problem;
    const G T_map_fresh = see_fresh(problem);
    see_map(problem);
    problem.prior = prior(T_map_fresh);
    if (params_.signatures) problem.looks_alike = similar;
    KnownProblem known{std::move(problem), in_common() ? "match" : "nomatch", T_map_fresh, {}};
    for (std::size_t i = 0; i < fresh_.size() && in_common(); ++i)
      if (const auto j = std::find(mapped_.begin(), mapped_.end(), fresh_[i]); j != mapped_.end())
        known.pairs.emplace(i, j - mapped_.begin());
    return known;
  }

 private:
  using Things = std::vector<std::size_t>;  // by number
  using Point = typename G::Point;
  using PointCovariance = typename G::PointCovariance;
  static constexpr double step_m = 0.5;
  static constexpr double drift_m_per_sqrt_m = 0.015, drift_rad_per_sqrt_m = 1.5e-4;

  bool in_common() const { return params_.overlap > 0.0; }

  // 22 m and so many degrees are 95 % of two dimensions; in space 1 m in height and 1 degree of roll and pitch.
  typename G::Tangent prior_sigma() const {
    constexpr double within_95 = 2.4477, degree = std::numbers::pi / 180.0;
    typename G::Tangent sigma = G::Tangent::Constant(degree);
    sigma[G::Dim - 1] = 1.0;
    sigma.template head<2>().setConstant(22.0 / within_95);
    sigma[G::Dof - 1] = params_.heading_deg * degree / within_95;
    return sigma;
  }

  // So small that true pairs are individually compatible.
  typename G::Tangent draw_prior_error() {
    while (true) {
      const auto unit = random_.unit_normal<G::Dof>();
      if (unit.squaredNorm() < 0.95 * chi2_quantile(0.95, G::Dim)) return prior_sigma().cwiseProduct(unit);
    }
  }

  // Streets that are long enough for the way and the map. Without anything in common, the way leads through others.
  void build() {
    const TownStyle style(random_, params_.regularity, G::Dim == 3);
    double length_m = std::max({60.0, params_.mapped / 0.7, 1.3 * way_m_});
    do {
      streets_ = streets(params_.layout, length_m);
      test::Random here(params_.seed + 1'000'000), elsewhere(params_.seed + 2'000'000);
      mapped_things_ = style.things(here, streets_);
      driven_things_ = in_common() ? mapped_things_ : style.things(elsewhere, streets_);
      length_m *= 1.15;
    } while (mapped_things_.size() < whole(1.15 * params_.mapped) + whole(params_.fresh) ||
             along(0.0, length_m).size() < whole(params_.fresh) || streets_[0].length_m() < 1.05 * way_m_);
  }

  static std::size_t whole(double count) { return static_cast<std::size_t>(count); }

  // Of the street that is driven.
  Things along(double from_m, double to_m) const {
    Things found;
    for (std::size_t k = 0; k < driven_things_.size(); ++k)
      if (const Thing& t = driven_things_[k]; t.street == 0 && t.s_m >= from_m && t.s_m <= to_m) found.push_back(k);
    return found;
  }

  // So many of them, in no order.
  Things drawn(Things from, std::size_t count) {
    count = std::min(count, from.size());
    for (std::size_t k = 0; k < count; ++k) std::swap(from[k], from[k + random_.engine()() % (from.size() - k)]);
    from.resize(count);
    return from;
  }

  static Things without(Things things, const Things& others) {
    std::erase_if(things, [&](std::size_t k) { return std::find(others.begin(), others.end(), k) != others.end(); });
    return things;
  }

  static Things both(Things some, const Things& others) {
    some.insert(some.end(), others.begin(), others.end());
    return some;
  }

  void choose_way() {
    for (;; way_m_ *= 1.15) {
      start_m_ = random_.uniform(0.0, std::max(0.0, streets_[0].length_m() - way_m_));
      if (along(start_m_, start_m_ + way_m_).size() >= whole(params_.fresh)) return;
    }
  }

  void choose_landmarks() {
    const Things within = along(start_m_, start_m_ + way_m_);
    Things shareable = within;
    if (params_.one_stretch) {  // the way enters what is mapped, or leaves it
      const double share = std::clamp(1.6 * params_.overlap, 0.3, 1.0);
      const double from_m = start_m_ + random_.integer(0, 1) * (1.0 - share) * way_m_;
      shareable = along(from_m, from_m + share * way_m_);
    }
    const Things common = drawn(shareable, whole(std::round(params_.overlap * params_.fresh)));
    fresh_ = both(common, drawn(without(within, common), whole(params_.fresh) - common.size()));
    mapped_ = both(common, drawn(unshared_map(), whole(params_.mapped) - common.size()));
    fresh_ = drawn(fresh_, fresh_.size());
    mapped_ = drawn(mapped_, mapped_.size());
  }

  // What the map may hold besides: around the way rather than anywhere, if there is plenty.
  Things unshared_map() {
    std::vector<std::pair<double, std::size_t>> by_distance;
    for (std::size_t k = 0; k < mapped_things_.size(); ++k) {
      const Thing& t = mapped_things_[k];
      const double away_m = std::abs(t.s_m - start_m_ - 0.5 * way_m_) + (t.street == 0 ? 0.0 : 40.0);
      by_distance.emplace_back(away_m * random_.uniform(0.75, 1.25), k);
    }
    std::sort(by_distance.begin(), by_distance.end());
    Things things;
    for (const auto& [away_m, k] : by_distance) things.push_back(k);
    if (in_common()) things = without(std::move(things), fresh_);  // those in common, too
    if (things.size() > whole(1.3 * params_.mapped)) things.resize(whole(params_.mapped));
    return things;
  }

  // Where it is, and where it takes itself to be, every step.
  void drive() {
    const SE2::Tangent drift(drift_m_per_sqrt_m, drift_m_per_sqrt_m, drift_rad_per_sqrt_m);
    true_ = {streets_[0].at(start_m_)};
    believed_ = {SE2()};
    for (double s_m = step_m; s_m < way_m_ + step_m; s_m += step_m) {
      const SE2 next = streets_[0].at(start_m_ + s_m), U = true_.back().inverse() * next;
      believed_.push_back(believed_.back() * U *
                          SE2::Exp(std::sqrt(step_m) * drift.cwiseProduct(random_.unit_normal<3>())));
      true_.push_back(next);
    }
  }

  // Where on its street a thing converges: before or after it is passed. [m]
  double seen_at(const Thing& thing) { return thing.s_m - random_.uniform(-4.0, 8.0); }

  // New landmarks. Returns T_map_fresh, which fits them best but for their noise.
  G see_fresh(AssociationProblem<G>& problem) {
    typename G::Tangent tilt = G::Tangent::Zero();
    if constexpr (G::Dim == 3) tilt.template segment<2>(3) = prior_error_.template segment<2>(3);
    const G T_fresh_level = G::Exp(tilt).inverse();
    problem.fresh.anchor = {{2, 1}, 1};
    problem.fresh.drift_m2_per_m = drift_m_per_sqrt_m * drift_m_per_sqrt_m;
    Batch<G> exact_fresh, exact_map;
    std::vector<IndexPairing> same;
    for (const std::size_t k : fresh_) {
      const Thing& thing = driven_things_[k];
      const double way_m = std::clamp(seen_at(thing) - start_m_, 0.0, way_m_);
      const auto step = static_cast<std::size_t>(way_m / step_m);
      const Point level = place(thing, believed_[step] * true_[step].inverse());
      const PointCovariance R = T_fresh_level.rotation(), S = noise(level, believed_[step]);
      same.emplace_back(same.size(), same.size());
      append(exact_map, place(thing, T_map_world_), S);
      append(exact_fresh, T_fresh_level * level, S);
      append(problem.fresh, T_fresh_level * Point(level + random_.draw<G::Dim>(S)), R * S * R.transpose());
      sign(problem.fresh, thing);
      problem.fresh.abscissa_m.push_back(way_m);
      problem.fresh_id.push_back(problem.fresh_id.size());
    }
    return closed_form_alignment(exact_map, exact_fresh, same);
  }

  void see_map(AssociationProblem<G>& problem) {
    problem.map.anchor = {{1, 1}, 1};
    for (const std::size_t k : mapped_) {
      const Thing& thing = mapped_things_[k];
      const Point there = place(thing, T_map_world_);
      const PointCovariance S = noise(there, T_map_world_ * streets_[thing.street].at(seen_at(thing)));
      append(problem.map, there + random_.draw<G::Dim>(S), S);
      sign(problem.map, thing);
      problem.map_id.push_back(problem.map_id.size());
    }
  }

  static Point place(const Thing& thing, const SE2& T) {
    Point p;
    p[G::Dim - 1] = thing.place.z();
    p.template head<2>() = T * SE2::Point(thing.place.head<2>());
    return p;
  }

  // Longer along the line of sight.
  PointCovariance noise(const Point& landmark, const SE2& from) {
    const Eigen::Vector2d sight = (landmark.template head<2>() - from.translation()).normalized();
    const double along_m = params_.sigma_m * random_.uniform(0.9, 1.5);
    const double across_m = params_.sigma_m * random_.uniform(0.4, 0.8);
    PointCovariance S = across_m * across_m * PointCovariance::Identity();
    S.template topLeftCorner<2, 2>() += (along_m * along_m - across_m * across_m) * sight * sight.transpose();
    return S;
  }

  static void append(Batch<G>& batch, const Point& p, const PointCovariance& S) {
    LandmarkFact<G> landmark;
    landmark.key = {batch.anchor.chain, static_cast<std::uint32_t>(batch.landmarks.size())};
    landmark.anchor = batch.anchor.index;
    landmark.position = p;
    landmark.covariance = symmetrised(S);
    batch.landmarks.push_back(landmark);
  }

  // As it is seen: each bit is another one now and then.
  void sign(Batch<G>& batch, const Thing& thing) {
    if (!params_.signatures) return;
    std::uint64_t seen = thing.signature;
    for (int bit = 0; bit < 64; ++bit)
      if (random_.uniform(0.0, 1.0) < 0.05) seen ^= std::uint64_t{1} << bit;
    std::memcpy(batch.landmarks.back().descriptor.bytes.data(), &seen, sizeof seen);
  }

  static bool similar(const LandmarkFact<G>& i, const LandmarkFact<G>& j) {
    constexpr int max_different_bits = 18;
    std::uint64_t a = 0, b = 0;
    std::memcpy(&a, i.descriptor.bytes.data(), sizeof a);
    std::memcpy(&b, j.descriptor.bytes.data(), sizeof b);
    return std::popcount(a ^ b) <= max_different_bits;
  }

  // Level, off by the error that was drawn.
  RelativePrior<G> prior(const G& truth) const {
    RelativePrior<G> prior;
    const PointCovariance R = truth.rotation();
    typename G::Tangent turn = G::Tangent::Zero(), shift = G::Tangent::Zero();
    turn[G::Dof - 1] = std::atan2(R(1, 0), R(0, 0)) - prior_error_[G::Dof - 1];
    shift.template head<G::Dim>() = truth.translation() - prior_error_.template head<G::Dim>();
    prior.mean = G::Exp(shift) * G::Exp(turn);
    prior.covariance = prior_sigma().cwiseAbs2().asDiagonal();
    return prior;
  }

  StreetProblemParams params_;
  test::Random random_;
  typename G::Tangent prior_error_;  // position and roll, pitch, yaw
  double way_m_, start_m_ = 0.0;     // on the first street
  SE2 T_map_world_;
  std::vector<Street> streets_;
  std::vector<Thing> mapped_things_, driven_things_;  // the same if there is something in common
  Things fresh_, mapped_;
  std::vector<SE2> true_, believed_;  // T_world_vehicle, T_start_vehicle
};

/// 29 problems with something in common and 9 without, `batches` batches of new landmarks in a row in each. With
/// `signatures`, landmarks of every other one of the smaller ones say what they look like, as in the recorded ones.
inline std::vector<KnownProblem> street_problems(int batches, bool signatures, std::uint64_t seed) {
  constexpr double irregular = 0.15, street = 0.5, hard = 1.0;  // repeated facades and little else
  struct Row {
    int fresh, mapped;  // of one batch
    double overlap, sigma_m, regularity, heading_deg = 20.0;
  };
  static const std::vector<Row> rows = {
      {10, 50, 0.5, 0.05, irregular},   {10, 50, 0.5, 0.1, street},         {10, 200, 0.5, 0.05, irregular},
      {10, 200, 0.5, 0.1, street, 5.0}, {20, 50, 0.3, 0.05, irregular},     {20, 50, 0.5, 0.2, street},
      {20, 200, 0.3, 0.05, street},     {20, 200, 0.5, 0.1, irregular},     {20, 200, 0.5, 0.1, hard},
      {20, 1000, 0.5, 0.1, street},     {50, 200, 0.1, 0.05, irregular},    {50, 200, 0.2, 0.05, street},
      {50, 200, 0.3, 0.1, irregular},   {50, 200, 0.5, 0.2, street},        {50, 200, 0.5, 0.5, irregular},
      {50, 1000, 0.2, 0.05, hard},      {50, 1000, 0.3, 0.1, street},       {50, 1000, 0.5, 0.2, irregular},
      {50, 5000, 0.3, 0.1, irregular},  {100, 200, 0.2, 0.1, street},       {100, 1000, 0.05, 0.05, irregular},
      {100, 1000, 0.1, 0.05, street},   {100, 1000, 0.2, 0.1, irregular},   {100, 1000, 0.3, 0.2, hard},
      {100, 5000, 0.2, 0.1, street},    {200, 1000, 0.05, 0.05, irregular}, {200, 1000, 0.1, 0.1, street},
      {200, 1000, 0.3, 0.2, irregular}, {200, 5000, 0.2, 0.1, street},      {10, 50, 0.0, 0.1, street},
      {20, 200, 0.0, 0.05, irregular},  {20, 200, 0.0, 0.2, street},        {50, 200, 0.0, 0.1, hard},
      {50, 200, 0.0, 0.3, irregular},   {50, 1000, 0.0, 0.1, street},       {100, 1000, 0.0, 0.05, hard},
      {100, 1000, 0.0, 0.2, street},    {200, 1000, 0.0, 0.1, irregular},
  };
  std::vector<KnownProblem> problems;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const Row& row = rows[k];
    StreetProblemParams params;
    params.layout = static_cast<Layout>(k % 4);
    params.one_stretch = k % 4 == 2;
    params.fresh = batches * row.fresh;
    params.way_m = batches * std::max(20.0, 1.0 * row.fresh);
    params.mapped = row.mapped;
    params.overlap = row.overlap;
    params.sigma_m = row.sigma_m;
    params.regularity = row.regularity;
    params.heading_deg = row.heading_deg;
    params.signatures = signatures && k % 2 == 1 && row.mapped <= 1000;
    params.seed = 1000 * seed + k;
    problems.push_back(k % 5 == 4 ? StreetProblem<SE3>(params).make() : StreetProblem<SE2>(params).make());
  }
  return problems;
}

}  // namespace convoy::bench
