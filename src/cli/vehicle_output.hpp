// What a vehicle process leaves in its output folder; the contract with the evaluation (evaluate/run_folder.hpp).
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/geometry/groups.hpp>

#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace convoy::cli {

/// Appends to live.csv, traffic.csv and labels.csv while the vehicle runs (a restarted vehicle goes on in the same
/// files), and writes trajectory.csv, map.json, facts.jsonl and summary.json at its end. Throws ConfigError.
template <class G>
class VehicleOutput {
 public:
  explicit VehicleOutput(const std::filesystem::path& folder);

  void write_label(Epoch epoch, std::uint32_t index, std::uint64_t track);
  void write_live(double t_s, const VehicleSnapshot<G>& snapshot, const SubmapManager<G>& manager);
  /// The vehicle is about to begin a new epoch: what it drove in this one goes to trajectory.csv, too.
  void keep_trail(const SubmapManager<G>& manager, const FrontEndComponent<G>& front_end);
  void write_end(double t_s, const VehicleSnapshot<G>& snapshot, SubmapManager<G>& manager,
                 const FrontEndComponent<G>& front_end);

 private:
  std::ofstream appending(const std::string& name, std::string_view header);

  std::filesystem::path folder_;
  std::ofstream live_, traffic_, labels_;
  std::vector<std::pair<ChainId, std::vector<ChainState<G>>>> trails_;  ///< of the epochs before this one
  bool complete_ = true;                                                ///< everything could be written so far
};

}  // namespace convoy::cli
