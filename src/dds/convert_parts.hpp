// What the conversions of all types are made of; internal to the library.
#pragma once

#include <convoy/dds/convert.hpp>
#include <convoy/dds/wire_bounds.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace convoy::dds::parts {

// ---- group elements --------------------------------------------------------------------------------------------

inline std::vector<double> coordinates(const SE2& T) { return {T.translation().x(), T.translation().y(), T.theta()}; }
inline std::vector<double> coordinates(const SE3& T) {
  const SE3::Point& t = T.translation();
  const SE3::Quaternion& q = T.quaternion();
  return {t.x(), t.y(), t.z(), q[0], q[1], q[2], q[3]};
}

inline bool all_finite(const std::vector<double>& c) {
  return std::all_of(c.begin(), c.end(), [](double value) { return std::isfinite(value); });
}

inline WireStatus from_coordinates(const std::vector<double>& c, SE2& T) {
  if (c.size() != 3) return WireStatus::wrong_size;
  if (!all_finite(c)) return WireStatus::not_finite;
  // The content hash of a fact covers the angle as stored: an angle that would be wrapped here was not written by us.
  if (wrap_angle(c[2]) != c[2]) return WireStatus::out_of_range;
  T = SE2(c[0], c[1], c[2]);
  return WireStatus::ok;
}
inline WireStatus from_coordinates(const std::vector<double>& c, SE3& T) {
  if (c.size() != 7) return WireStatus::wrong_size;
  if (!all_finite(c)) return WireStatus::not_finite;
  const SE3::Quaternion q(c[3], c[4], c[5], c[6]);
  T = SE3(q, {c[0], c[1], c[2]});
  // For the same reason: a quaternion that is not of length one, or -q for q, was not written by us.
  return T.quaternion() == q ? WireStatus::ok : WireStatus::out_of_range;
}

// ---- small parts -----------------------------------------------------------------------------------------------

template <class Matrix>
WireStatus pack(const Matrix& P, std::vector<double>& out) {
  out.clear();
  out.reserve(static_cast<std::size_t>(P.rows() * (P.rows() + 1) / 2));
  for (Eigen::Index r = 0; r < P.rows(); ++r)
    for (Eigen::Index c = r; c < P.cols(); ++c) {
      if (P(r, c) != P(c, r)) return std::isfinite(P(r, c)) ? WireStatus::not_symmetric : WireStatus::not_finite;
      out.push_back(P(r, c));
    }
  return WireStatus::ok;
}

template <class Matrix>
WireStatus unpack(const std::vector<double>& in, Matrix& P) {
  if (in.size() != static_cast<std::size_t>(P.rows() * (P.rows() + 1) / 2)) return WireStatus::wrong_size;
  auto next = in.begin();
  for (Eigen::Index r = 0; r < P.rows(); ++r)
    for (Eigen::Index c = r; c < P.cols(); ++c) {
      if (!std::isfinite(*next)) return WireStatus::not_finite;
      P(r, c) = P(c, r) = *next++;
    }
  return WireStatus::ok;
}

template <class Point>
WireStatus from_wire_vector(const std::vector<double>& in, Point& point) {
  if (in.size() != static_cast<std::size_t>(point.size())) return WireStatus::wrong_size;
  std::copy(in.begin(), in.end(), point.data());
  return point.allFinite() ? WireStatus::ok : WireStatus::not_finite;
}

/// Nothing stands for zero.
template <class Vector>
std::vector<double> to_wire_unless_zero(const Vector& v) {
  return v.isZero(0.0) ? std::vector<double>() : std::vector<double>(v.data(), v.data() + v.size());
}

template <class Vector>
WireStatus from_wire_vector_or_zero(const std::vector<double>& in, Vector& v) {
  v.setZero();
  return in.empty() ? WireStatus::ok : from_wire_vector(in, v);
}

inline v1::Chain wire_chain(const ChainId& chain) {
  v1::Chain out;
  out.epoch(chain.epoch);
  out.vehicle(chain.vehicle);
  return out;
}

inline ChainId core_chain(const v1::Chain& chain) { return {chain.vehicle(), chain.epoch()}; }

template <class Sample>
ChainId author(const Sample& sample) {
  return {sample.vehicle(), sample.epoch()};
}

template <class Sample>
void set_author(const ChainId& chain, Sample& sample) {
  sample.vehicle(chain.vehicle);
  sample.epoch(chain.epoch);
}

template <class Sample>
void set_key(const ChainId& sender, const Key& key, Sample& sample) {
  sample.sender(wire_chain(sender));
  set_author(key.chain, sample);
  sample.index(key.index);
}

/// Sender and author are somebody.
template <class Sample>
WireStatus check_names(const Sample& sample) {
  return sample.sender().vehicle() != 0 && sample.vehicle() != 0 ? WireStatus::ok : WireStatus::out_of_range;
}

template <class G, class Sample>
WireStatus check_dimension(const Sample& sample) {
  return sample.dimension() == G::Dim ? WireStatus::ok : WireStatus::wrong_dimension;
}

template <class... Rest>
WireStatus first_refusal(WireStatus first, Rest... rest) {
  if constexpr (sizeof...(rest) == 0) return first;
  else return first != WireStatus::ok ? first : first_refusal(rest...);
}

template <class G>
WireStatus to_wire_state(const ChainState<G>& state, v1::ChainState& out) {
  out.stamp_s(state.stamp_s);
  out.abscissa_m(state.abscissa_m);
  out.pose(coordinates(state.pose));
  out.heading_lever(to_wire_unless_zero(state.heading_lever));
  return pack(state.drift, out.drift());
}

template <class G>
WireStatus from_wire_state(const v1::ChainState& in, ChainState<G>& state) {
  if (!std::isfinite(in.stamp_s()) || !std::isfinite(in.abscissa_m())) return WireStatus::not_finite;
  state.stamp_s = in.stamp_s();
  state.abscissa_m = in.abscissa_m();
  return first_refusal(from_coordinates(in.pose(), state.pose), unpack(in.drift(), state.drift),
                       from_wire_vector_or_zero(in.heading_lever(), state.heading_lever));
}

// The core's enums and the wire's have the same numbers.
static_assert(v1::KIND_ABSOLUTE_FIX == static_cast<std::uint32_t>(FactKind::absolute_fix));
static_assert(v1::KIND_ENCOUNTER == static_cast<std::uint32_t>(FactKind::encounter));
static_assert(v1::KIND_WAYPOINT == static_cast<std::uint32_t>(FactKind::waypoint));
static_assert(fact_kind_count == static_cast<int>(bounds::kinds));
static_assert(v1::INTEGRITY_SUSPECT == static_cast<std::uint32_t>(Integrity::suspect));
static_assert(v1::DESCRIPTOR_PATCH_8X8_4BIT == static_cast<std::uint32_t>(Descriptor::Kind::patch_8x8_4bit));

template <class To, class From>
WireStatus convert_enum(From from, From last, To& to) {
  if (static_cast<std::uint32_t>(from) > static_cast<std::uint32_t>(last)) return WireStatus::unknown_enum;
  to = static_cast<To>(from);
  return WireStatus::ok;
}

}  // namespace convoy::dds::parts
