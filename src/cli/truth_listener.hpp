// What the simulator says of the truth, for whoever judges a run: never for a vehicle.
#pragma once

#include <convoy/geometry/se3.hpp>
#include <convoy/submap/facts.hpp>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <vector>

#include "scenario/scenario.hpp"

namespace convoy::cli {

/// Of what was heard, how much was refused.
struct TruthCounters {
  std::uint64_t foreign = 0;   ///< of another run: somebody else's truth
  std::uint64_t unusable = 0;  ///< not of its type, beyond its bounds, no pose, or not a depth for each pixel
};

/// Hears Truth and TruthDepth of idl/sensors.idl in lock-step, and finds for each sighting of a landmark
/// (RUN/vehicle_<id>/sightings.csv, which the vehicle writes before it is done with the step) the point of the world
/// that the pixel shows. For one thread.
class TruthListener {
 public:
  /// `run`: that of convoy sim --run. Throws ConfigError if Fast DDS does not make what is needed.
  TruthListener(std::uint32_t domain, std::uint64_t run, const std::filesystem::path& run_folder,
                const std::vector<VehicleId>& vehicles);
  ~TruthListener();
  TruthListener(const TruthListener&) = delete;
  TruthListener& operator=(const TruthListener&) = delete;

  /// Takes what has come in. Call it ten times a second or more.
  void take();

  /// The path so far. At t = 0 it stands where it was heard of first.
  std::vector<TruthPose<SE3>> path(VehicleId vehicle) const;
  double time_s() const;  ///< of the last pose
  const TruthCounters& counters() const;

  /// Writes RUN/truth/tracks_<id>.csv: for each track the median of the points that its pixels showed.
  void write_tracks() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace convoy::cli
