// A fleet of known truth and its facts, drawn from the model that the map assumes.
#pragma once

#include <convoy/drift/drift_model.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "../random_world.hpp"
#include "../sample_facts.hpp"

#include <map>
#include <optional>
#include <type_traits>
#include <vector>

namespace convoy::test {

/// One number for every translation, another for every rotation.
template <class G>
typename G::Tangent each(double translation, double rotation);

/// A pose on the street; in space, with some height, pitch and roll to it.
template <class G>
G on_the_street(double x_m, double y_m, double theta_rad);

template <class G>
class SampleFleetOf {
 public:
  /// `scale`: of all errors drawn, not of the covariances stated.
  /// `shared_m`: of the error that a batch has in common.
  explicit SampleFleetOf(std::uint64_t seed, double scale = 1.0, double shared_m = 0.1);
  SampleFleetOf(const SampleFleetOf&);
  ~SampleFleetOf();

  /// A chain begins. `sigma`: of the static bias (m, m, rad); zero: the start is not known to anybody.
  void start(VehicleId v, const G& T_world_start, const typename G::Tangent& sigma = G::Tangent::Zero());

  /// The vehicle moves to T_world_anchor and freezes every point within 20 m there. Returns the anchor's key.
  Key stop(VehicleId v, const G& T_world_anchor);

  /// What two batches have in common, at most `count`.
  std::vector<Pairing> common(const Key& a, const Key& b, std::size_t count = 1000) const;

  Hash associate(VehicleId author, const std::vector<Pairing>& pairings);
  void judge(VehicleId author, Hash hypothesis, bool veto);

  /// A receiver says where its antenna was at that anchor, east-north(-up) being enu_of_world() of the world. `error`:
  /// of the position [m]. `hung_on`: the anchor to refer to, if it is another one before.
  Key fix(const Key& at, const typename G::Point& error, double sigma_m, std::optional<std::uint32_t> hung_on = {});
  Key fix(const Key& at, double sigma_m, std::optional<std::uint32_t> hung_on = {});
  /// Turned about z, and far away.
  static G enu_of_world();

  FactStore<G> store() const { return store_of(facts); }
  static FactStore<G> store_of(const std::vector<AnyFact<G>>& list);
  const AnchorFact<G>& anchor(const Key& key) const { return anchors_.at(key.chain.vehicle).at(key.index); }
  Random& random() { return random_; }

  std::vector<AnyFact<G>> facts;
  std::map<Key, G> truth;  ///< T_world_anchor
  std::map<Key, typename G::Point> point_of;

 private:
  struct Chain {
    G pose;
    std::uint32_t next_landmark = 0;
  };
  Random random_;
  double scale_, shared_m_;
  PointsOf<G> points_;
  std::map<VehicleId, Chain> chains_;
  std::map<VehicleId, std::vector<AnchorFact<G>>> anchors_;
  std::map<Key, std::map<std::size_t, Key>> landmarks_;
  std::map<VehicleId, std::uint32_t> associations_, verdicts_, fixes_;
};

using SampleFleet = SampleFleetOf<SE2>;

template <class G>
inline const typename G::Tangent paper_bias_of = each<G>(15.0, 0.2);
template <class G>
inline const typename G::Tangent fair_start_of = each<G>(0.5, 0.02);
template <class G>
inline const typename G::Tangent known_start_of = each<G>(0.01, 0.001);
inline const SE2::Tangent paper_bias = each<SE2>(15.0, 0.2), fair_start = each<SE2>(0.5, 0.02),
                          known_start = each<SE2>(0.01, 0.001);

template <class G>
struct StreetOptionsOf {
  double scale = 1.0;
  double shared_m = 0.1;
  bool associated = true;
  typename G::Tangent bias = paper_bias_of<G>;  ///< of vehicles 2 and 3; vehicle 1 knows its start
};
using StreetOptions = StreetOptionsOf<SE2>;

/// Three vehicles on one street, one behind the other, who meet in several places.
template <class G = SE2>
SampleFleetOf<G> street_fleet(std::uint64_t seed, const std::type_identity_t<StreetOptionsOf<G>>& options = {});

/// One hypothesis is enough to link two vehicles, however uncertain their starts are.
inline const SelectionParams unconfirmed_too = [] {
  SelectionParams params;
  params.min_confirmed = 1;
  return params;
}();

template <class G>
GlobalMap<G> built(const FactStore<G>& store, const SelectionParams& params = {});

}  // namespace convoy::test
