#include "replay/drive.hpp"

#include <convoy/config_error.hpp>

#include <algorithm>
#include <cstdio>

namespace convoy::cli {

namespace {

VehicleParams<SE3> vehicle_params(const std::filesystem::path& folder) {
  VehicleParams<SE3> params;
  params.id = Drive::self;
  params.state_folder = folder / "state";
  params.journal = true;  // so that a new epoch begins with the facts of those before
  params.fresh_epoch = [] { return Epoch{1}; };
  params.static_bias = Estimate<SE3>{};  // its start is the common frame
  params.submaps.selection.reference = Drive::self;
  params.drift.persistent.scale = 0.01;  // odometers are rarely calibrated
  return params;
}

}  // namespace

FrontEndFrame counted(const ImageReport& report) {
  FrontEndFrame frame;
  frame.t_s = report.stamp_s;
  frame.took_ms = report.took_ms;
  frame.sought = static_cast<std::uint32_t>(report.sought);
  for (const TrackedFeature& f : report.features) {
    const bool is_new = f.score == 0.0;
    frame.started += is_new;
    frame.tracked += !is_new;
    frame.landmarks += f.landmark;
    frame.converged += f.converged;
  }
  return frame;
}

Drive::Drive(Recording& recording, const MonocularSlamParams& params, const std::filesystem::path& folder)
    : recording_(recording),
      slam_(params, recording.calibration, recording.T_body_camera),
      output_(folder),
      vehicle_(
          vehicle_params(folder), slam_, [this] { return network_.join(); }, [this] { return now_s_; }) {
  slam_.on_report([this](const ImageReport& report, const cv::Mat& grey) { note(report, grey); });
  vehicle_.on_export([this](std::uint32_t index, std::uint64_t track) {
    ++exported_;
    output_.write_label(epoch_, index, track);
  });
}

void Drive::run() {
  image_ = recording_.next_image();
  for (const OdometerReading& reading : recording_.odometry) {
    feed_images(reading.stamp_s);
    if (!to_s_) {
      drive(reading);  // the first one only says when time begins: then the chain can
      begin_epoch();
      for (FrontEndFrame& frame : frames_) frame.epoch = epoch_;  // an image of that very time
    } else vehicle_.feed([&] { drive(reading); });
    if (slam_.lost()) begin_again();
    tell(reading.stamp_s);
  }
  finish();
}

void Drive::feed_images(double until_s) {
  for (; image_.status != SourceImage::Status::end && image_.stamp_s <= until_s; image_ = recording_.next_image()) {
    if (image_.status == SourceImage::Status::refused)
      std::fprintf(stderr, "convoy replay: left out: %s\n", image_.why.c_str());
    else if (image_.stamp_s < recording_.odometry.front().stamp_s) ++images_outside_;
    else (void)slam_.on_image(image_.stamp_s, image_.grey);  // counted there if it is refused
  }
}

void Drive::drive(const OdometerReading& reading) {
  T_start_from_ = T_start_to_;
  from_s_ = to_s_.value_or(reading.stamp_s);
  if (to_s_) {
    SE3::Tangent step = SE3::Tangent::Zero();
    step[0] = reading.distance_m;
    step[5] = reading.yaw_rate_radps * (reading.stamp_s - from_s_);
    T_start_to_ = T_start_from_ * SE3::Exp(step);
  }
  to_s_ = reading.stamp_s;
  slam_.on_odometry(reading.stamp_s, reading.distance_m, reading.yaw_rate_radps);
}

void Drive::note(const ImageReport& report, const cv::Mat& grey) {
  const double share = *to_s_ > from_s_ ? (report.stamp_s - from_s_) / (*to_s_ - from_s_) : 1.0;
  const FrontEndState<SE3> state = slam_.state();
  FrontEndFrame frame = counted(report);
  frame.epoch = epoch_;
  frame.path_m = path_before_m_ + state.abscissa_m;
  frame.T_start_body = T_start_epoch_ * state.pose;
  frame.T_start_odometry = T_start_from_ * SE3::Exp(share * (T_start_from_.inverse() * T_start_to_).Log());
  frame.exported = exported_;
  pictures_.look(frames_.size(), grey, report.features);
  frames_.push_back(frame);
}

void Drive::begin_epoch() {
  vehicle_.configure();
  epoch_ = vehicle_.snapshot().self.epoch;
}

void Drive::begin_again() {
  const FrontEndState<SE3> end = slam_.state();
  std::fprintf(stderr, "convoy replay: lost after %.1f m, begins anew\n", path_before_m_ + end.abscissa_m);
  vehicle_.inspect([&](const auto& manager, const auto& front_end) { output_.keep_trail(manager, front_end); });
  T_start_epoch_ = T_start_epoch_ * end.pose;
  path_before_m_ += end.abscissa_m;
  vehicle_.shutdown();
  slam_.restart();
  begin_epoch();
}

// Once a second, what a vehicle says of itself.
void Drive::tell(double now_s) {
  now_s_ = now_s;
  progress_.tell(frames_.size(), now_s);
  if (now_s_ < next_live_s_) return;
  next_live_s_ = now_s_ + 1.0;
  vehicle_.inspect([&](SubmapManager<SE3>& manager, auto&) {
    manager.step(now_s_);
    manager.rebuild(now_s_);
  });
  const VehicleSnapshot<SE3> snapshot = vehicle_.snapshot();
  vehicle_.inspect([&](SubmapManager<SE3>& manager, auto&) { output_.write_live(now_s_, snapshot, manager); });
}

void Drive::finish() {
  for (; image_.status != SourceImage::Status::end; image_ = recording_.next_image()) ++images_outside_;
  vehicle_.feed([&] { slam_.finish(); });
  if (!frames_.empty()) frames_.back().exported = exported_;
  vehicle_.inspect([&](SubmapManager<SE3>& manager, auto&) { manager.rebuild(now_s_, true); });
  const VehicleSnapshot<SE3> snapshot = vehicle_.snapshot();
  vehicle_.inspect([&](SubmapManager<SE3>& manager, FrontEndComponent<SE3>& front_end) {
    output_.write_end(now_s_, snapshot, manager, front_end);
  });
  vehicle_.shutdown();
}

}  // namespace convoy::cli
