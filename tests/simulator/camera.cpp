#include "camera.hpp"

#include "four.hpp"
#include "random.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace convoy::simulator {
namespace {

// Sensor numbers of the streams beside that of the noise.
constexpr std::uint32_t kStepStream = 0x10000, kDriftStream = 0x20000, kDropStream = 0x30000;

constexpr std::size_t kQuantiles = 4096;
constexpr float kToneSteps = 16.0F;  // entries of the tone curve per grey value

std::vector<float> spread_of(double sigma_px) {
  const int radius = static_cast<int>(std::ceil(3.0 * sigma_px));
  std::vector<double> kernel{1.0};
  for (int i = 1; i <= radius; ++i) kernel.push_back(std::exp(-0.5 * i * i / (sigma_px * sigma_px)));
  double sum = -kernel.front();
  for (const double value : kernel) sum += 2.0 * value;
  std::vector<float> spread;
  for (const double value : kernel) spread.push_back(static_cast<float>(value / sum));
  return spread;
}

/// Middles of equal shares of N(0, 1), scaled to variance 1.
std::vector<float> quantiles() {
  std::vector<double> exact;
  double squares = 0.0, x = -3.7;
  for (std::size_t i = 0; i < kQuantiles; ++i) {
    const double share = (static_cast<double>(i) + 0.5) / static_cast<double>(kQuantiles);
    for (int k = 0; k < 20; ++k) {
      const double step = (0.5 * std::erfc(-x * M_SQRT1_2) - share) * std::sqrt(2.0 * M_PI) * std::exp(0.5 * x * x);
      x -= std::clamp(step, -0.5, 0.5);
      if (std::abs(step) < 1e-12) break;
    }
    exact.push_back(x);
    squares += x * x;
  }
  const double scale = std::sqrt(static_cast<double>(kQuantiles) / squares);
  std::vector<float> scaled;
  for (const double value : exact) scaled.push_back(static_cast<float>(value * scale));
  return scaled;
}

std::vector<std::uint8_t> tone_curve(double gamma) {
  const auto entries = static_cast<std::size_t>(255.0F * kToneSteps) + 2;
  std::vector<std::uint8_t> curve;
  for (std::size_t i = 0; i < entries; ++i) {
    const double light = std::min(1.0, static_cast<double>(i) / (255.0 * static_cast<double>(kToneSteps)));
    curve.push_back(static_cast<std::uint8_t>(std::lround(255.0 * std::pow(light, 1.0 / gamma))));
  }
  return curve;
}

}  // namespace

Eigen::Isometry3d mount(double ahead_m, double left_m, double up_m, double down_rad) {
  Eigen::Isometry3d T_body_camera = Eigen::Isometry3d::Identity();
  T_body_camera.translation() = Eigen::Vector3d(ahead_m, left_m, up_m);
  Eigen::Matrix3d R_body_camera;
  R_body_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  T_body_camera.linear() = Eigen::AngleAxisd(down_rad, Eigen::Vector3d::UnitY()).toRotationMatrix() * R_body_camera;
  return T_body_camera;
}

void CameraParams::validate() const {
  lens.validate();
  rendering.validate();
  const auto require = [](double value, double low, double high, const char* name) {
    if (!(value >= low && value <= high))
      throw std::invalid_argument(std::string("CameraParams: ") + name + " is " + std::to_string(value) + "; give " +
                                  std::to_string(low) + " to " + std::to_string(high));
  };
  require(blur_px, 0.0, 3.0, "blur_px");
  require(vignetting, 0.0, 1.0, "vignetting");
  require(gain, 1e-3, 1e3, "gain");
  require(gain_drift, 0.0, 1.0, "gain_drift");
  require(drift_frames, 10.0, 1e9, "drift_frames");
  require(gain_step, 0.0, 1.0, "gain_step");
  require(frames_between_steps, 1, 1e9, "frames_between_steps");
  require(step_probability, 0.0, 1.0, "step_probability");
  require(gamma, 0.3, 4.0, "gamma");
  require(gamma_drift, 0.0, 0.5, "gamma_drift");
  require(full_well_electrons, 1.0, 1e9, "full_well_electrons");
  require(read_noise_electrons, 0.0, 1e6, "read_noise_electrons");
  require(drop_probability, 0.0, 1.0, "drop_probability");
  require(sensor, 0.0, 65535.0, "sensor");
  const Eigen::Matrix3d R = T_body_camera.linear();
  if (!T_body_camera.matrix().allFinite() || (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() > 1e-6)
    throw std::invalid_argument("CameraParams: T_body_camera is no rotation and translation; make it with mount()");
}

Camera::Camera(const Scene& scene, const CameraParams& params, std::shared_ptr<const std::vector<MipTexture>> textures)
    : params_((params.validate(), params)),
      rasteriser_(scene, Lens(params.lens), params.rendering, std::move(textures)),
      spread_(spread_of(params.blur_px)),
      falloff_(params.lens.width, params.lens.height),
      blurred_(params.lens.width, params.lens.height + 2 * (static_cast<int>(spread_.size()) - 1)),
      noise_(quantiles()) {
  const Lens& lens = rasteriser_.lens();
  for (int y = 0; y < falloff_.height; ++y)
    for (int x = 0; x < falloff_.width; ++x) {
      const double cos2 = 1.0 / (1.0 + lens.ray_of({x, y}).squaredNorm());
      falloff_.at(x, y) = static_cast<float>(1.0 + params.vignetting * (cos2 * cos2 - 1.0));
    }
}

std::optional<Frame> Camera::take(const Eigen::Isometry3d& T_world_body, std::uint32_t index) {
  if (dropped(index)) return std::nullopt;
  Frame frame{index, GreyImage(params_.lens.width, params_.lens.height), T_world_body * params_.T_body_camera};
  blur_along_rows(rasteriser_.render(frame.T_world_camera));
  expose(index, frame.image);
  return frame;
}

bool Camera::dropped(std::uint32_t index) const {
  return Stream({params_.seed, params_.vehicle, params_.sensor + kDropStream, index}).chance(params_.drop_probability);
}

double Camera::gain(std::uint32_t index) const {
  const std::uint32_t stretch = index / static_cast<std::uint32_t>(params_.frames_between_steps);
  Stream steps({params_.seed, params_.vehicle, params_.sensor + kStepStream, stretch});
  const double step = steps.chance(params_.step_probability) ? params_.gain_step * steps.gaussian() : 0.0;
  return params_.gain * std::exp(params_.gain_drift * drift(index, 0) + step);
}

double Camera::gamma(std::uint32_t index) const {
  return params_.gamma * std::exp(params_.gamma_drift * drift(index, 1));
}

/// Two waves whose lengths have no common multiple, together of variance 1.
double Camera::drift(std::uint32_t index, std::uint32_t which) const {
  Stream phases({params_.seed, params_.vehicle, params_.sensor + kDriftStream, which});
  const double turn = 2.0 * M_PI * index / params_.drift_frames;
  const double first = phases.uniform(0.0, 2.0 * M_PI), second = phases.uniform(0.0, 2.0 * M_PI);
  return std::sin(turn + first) + std::sin(turn / (1.0 + M_SQRT2) + second);
}

void Camera::blur_along_rows(const LightImage& light) {
  const int radius = static_cast<int>(spread_.size()) - 1, width = light.width;
  const auto edge = static_cast<std::size_t>(radius);
  std::vector<float> padded(static_cast<std::size_t>(width) + 2 * edge);
  float* const middle = padded.data() + radius;
  for (int y = 0; y < light.height; ++y) {
    const float* in = light.row(y);
    std::copy_n(in, width, middle);
    std::fill_n(padded.begin(), edge, in[0]);
    std::fill_n(middle + width, edge, in[width - 1]);
    float* out = blurred_.row(y + radius);
    int x = 0;
    for (; x + 4 <= width; x += 4) {
      Four sum = load(middle + x) * spread_[0];
      for (int i = 1; i <= radius; ++i)
        sum += (load(middle + x - i) + load(middle + x + i)) * spread_[static_cast<std::size_t>(i)];
      store(out + x, sum);
    }
    for (; x < width; ++x) {
      out[x] = middle[x] * spread_[0];
      for (int i = 1; i <= radius; ++i)
        out[x] += (middle[x - i] + middle[x + i]) * spread_[static_cast<std::size_t>(i)];
    }
  }
  for (int i = 0; i < radius; ++i) {
    std::copy_n(blurred_.row(radius), width, blurred_.row(i));
    std::copy_n(blurred_.row(radius + light.height - 1), width, blurred_.row(radius + light.height + i));
  }
}

void Camera::expose(std::uint32_t index, GreyImage& image) const {
  const std::vector<std::uint8_t> tones = tone_curve(gamma(index));
  const auto gain_now = static_cast<float>(gain(index));
  const auto per_electron = static_cast<float>(255.0 / params_.full_well_electrons);
  const auto read = static_cast<float>(params_.read_noise_electrons);
  const float read_variance = read * read * per_electron * per_electron;
  const int radius = static_cast<int>(spread_.size()) - 1, width = image.width;
  Stream stream({params_.seed, params_.vehicle, params_.sensor, index});
  std::vector<float> light(static_cast<std::size_t>(width));
  for (int y = 0; y < image.height; ++y) {
    const float* falloff = falloff_.row(y);
    for (int x = 0; x < width; ++x) light[static_cast<std::size_t>(x)] = blurred_.row(y + radius)[x] * spread_[0];
    for (int i = 1; i <= radius; ++i) {
      const float *above = blurred_.row(y + radius - i), *below = blurred_.row(y + radius + i);
      const float weight = spread_[static_cast<std::size_t>(i)];
      int x = 0;
      for (; x + 4 <= width; x += 4) {
        float* at = light.data() + x;
        store(at, load(at) + (load(above + x) + load(below + x)) * weight);
      }
      for (; x < width; ++x) light[static_cast<std::size_t>(x)] += (above[x] + below[x]) * weight;
    }
    std::uint8_t* out = image.row(y);
    std::uint32_t bits = 0;
    for (int x = 0; x < width; ++x) {
      bits = x % 2 == 0 ? stream() : bits >> 16U;
      const float signal = light[static_cast<std::size_t>(x)] * falloff[x] * gain_now;
      const float noise = noise_[bits % kQuantiles] * std::sqrt(signal * per_electron + read_variance);
      const float tone = std::clamp(signal + noise, 0.0F, 255.0F) * kToneSteps + 0.5F;
      out[x] = tones[static_cast<std::size_t>(static_cast<std::int32_t>(tone))];
    }
  }
}

}  // namespace convoy::simulator
