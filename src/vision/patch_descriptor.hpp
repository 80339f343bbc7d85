// What a landmark looks like, for other vehicles: Descriptor::Kind::patch_8x8_4bit, compared by similarity().
#pragma once

#include <convoy/submap/facts.hpp>
#include <convoy/vision/image_pyramid.hpp>

namespace convoy {

/// Side of the square that a descriptor shows [m], facing the camera. Both vehicles must use the same.
inline constexpr double descriptor_footprint_m = 1.0;

struct DescriptorResult {
  enum class Status : std::uint8_t {
    made,
    bad_input,     ///< the image is not valid, or a number not finite and positive
    too_small,     ///< the footprint is less than 6 px wide: too far away
    too_large,     ///< it is more than 128 px wide: too near
    out_of_image,  ///< it is not all in the image
    blank,         ///< it has too little contrast (standard deviation below 3 grey values)
  };
  Status status = Status::bad_input;
  Descriptor descriptor;  ///< of kind none unless made
};

/// 8 x 8 grey values, each a Gaussian mean about the middle of its piece of the footprint (standard deviation 0.6 of
/// the piece's side), less their mean and over their standard deviation, in 16 steps of 0.35 standard deviations.
/// `depth_m`: of the landmark along the camera's axis; `focal_px`: pixels of a metre at a depth of a metre, there.
DescriptorResult describe(const ImagePyramid& image, const Eigen::Vector2d& pixel, double depth_m, double focal_px);

}  // namespace convoy
