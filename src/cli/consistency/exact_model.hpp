// Facts drawn exactly from the model that the map assumes (DESIGN B1.3): drift is a small motion in the body frame
// where the vehicle is, batches are frozen relative to their closing anchor with what they share and what is each
// landmark's own, static biases are drawn from their covariance. The truth is given, what the SLAM says is drawn around
// it.
//
// A map that is computed rightly is then consistent: ANEES 1, in the band at 95 % of the steps.
#pragma once

#include <convoy/drift/drift_model.hpp>
#include <convoy/map/map.hpp>
#include <convoy/submap/fact_store.hpp>

#include <cstdint>
#include <string>
#include <vector>

#include "consistency/paths.hpp"
#include "consistency/statistic.hpp"

namespace convoy::cli::consistency {

struct ExactModelParams {
  Path path = Path::loop;
  int vehicles = 2;
  double noise = 1.0;  ///< factor on every standard deviation but the static bias
  double anchor_spacing_m = 25.0;
  double drift_m2_per_m = 2e-4;    ///< of translation; half of it the SLAM states itself, half it knows nothing of
  double drift_rad2_per_m = 4e-6;  ///< of rotation, likewise
  double landmark_sigma_m = 0.1;   ///< a landmark's own error
  double loading_sigma_m = 0.03;   ///< of each entry of the loadings
  double range_m = 20.0;
  std::size_t max_batch = 14;
  double start_sigma_m = 9.0, start_sigma_rad = 0.3;  ///< static bias of all vehicles but the first (the 22 m circle)
  double gap_m = 20.0;                                ///< each vehicle starts this far ahead of the one before
  PersistentDrift
      persistent;   ///< constants are drawn once per vehicle; in space, tilt and height may be bounded (`up` is set)
  int aliases = 0;  ///< stretches of the street that look exactly like another one, and are stated to be it
  int alias_places = 1;  ///< neighbouring anchors that each such stretch covers, so that its false sets agree
};

/// The rates and constants that describe this drift. Local: half is known to the SLAM. Literal: all of it, since the
/// literal model takes nothing from the SLAM.
template <class G>
DriftParams<G> matching_drift(const ExactModelParams& params, DriftModel model);

template <class G>
struct ExactFleet {
  FactStore<G> store;
  std::vector<TrueTrack<G>> tracks;         ///< anchors and the middles between them
  std::vector<Hash> true_sets, false_sets;  ///< hypotheses stated, by truth
};

/// Draws do not depend on `drift`: the same run under another model has the same errors. Every pair of batches with
/// five landmarks in common is stated as an association.
template <class G>
ExactFleet<G> draw_exact_fleet(const ExactModelParams& params, const DriftParams<G>& drift, std::uint64_t seed,
                               int run);

/// Real selection with the stated associations, the problem, `backend`, and the poses of its map.
template <class G>
RunSample judge_stated(const ExactFleet<G>& fleet, const Backend<G>& backend);

/// The same through build_global_map(), which may throw hypotheses and landmarks out.
template <class G>
RunSample judge_global_map(const ExactFleet<G>& fleet, const Backend<G>& backend);

}  // namespace convoy::cli::consistency
