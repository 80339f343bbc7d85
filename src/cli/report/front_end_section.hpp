// What front ends did, as a part of a page: time and features over the recording, the path beside the truth, and images
// with the features found in them, if there are any: files of their own, in frames/ beside the page.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "evaluate/front_end_record.hpp"

namespace convoy::cli {

/// `front_end`: of metrics.json, not null. `folder`: that of the run, for its images.
std::string front_end_section(const nlohmann::json& front_end, const std::vector<FrontEndFrame>& frames,
                              const std::vector<TruthPose<SE3>>& truth, const std::filesystem::path& folder);

/// Of a fleet: `vehicles` in the order of `drives`, with their own "front_end".
std::string front_end_section(const nlohmann::json& front_end, const nlohmann::json& vehicles,
                              const std::vector<FrontEndDrive>& drives);

/// A page of nothing else, for images without an odometer.
std::string make_front_end_page(const nlohmann::json& metrics, const std::vector<FrontEndFrame>& frames,
                                const std::filesystem::path& folder);

}  // namespace convoy::cli
