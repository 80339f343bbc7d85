// Time of a frame on the test street, and what it is to be compared with: the same without mipmaps and anisotropy, and
// the resampling of a frame by cv::remap alone.
#include "camera.hpp"
#include "test_street.hpp"

#include <benchmark/benchmark.h>
#include <opencv2/imgproc.hpp>

#include <cmath>

namespace {

using namespace convoy::simulator;

Eigen::Isometry3d body_at(std::uint32_t index) {
  Eigen::Isometry3d T_world_body = Eigen::Isometry3d::Identity();
  T_world_body.translation().x() = index % 100;
  T_world_body.linear() = Eigen::AngleAxisd(0.3 * std::sin(index), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return T_world_body;
}

void render(benchmark::State& state, const Filter& filter, double oversampling) {
  const Scene scene = test_street(150.0, static_cast<int>(state.range(0)));
  CameraParams params;
  params.rendering.filter = filter, params.rendering.oversampling = oversampling;
  Rasteriser rasteriser(scene, Lens(params.lens), params.rendering);
  std::uint32_t index = 0;
  for (auto _ : state)
    benchmark::DoNotOptimize(rasteriser.render(body_at(index++) * params.T_body_camera).values.data());
}

void BM_Render(benchmark::State& state) { render(state, {}, 1.5); }
void BM_Render8Taps(benchmark::State& state) { render(state, {true, 8}, 1.5); }
void BM_RenderOversampling2(benchmark::State& state) { render(state, {}, 2.0); }
void BM_RenderPlain(benchmark::State& state) { render(state, {false, 1}, 1.0); }
BENCHMARK(BM_Render)->Arg(2)->Arg(20)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_Render8Taps)->Arg(2)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_RenderOversampling2)->Arg(2)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_RenderPlain)->Arg(2)->Unit(benchmark::kMillisecond);

void BM_Frame(benchmark::State& state) {
  const Scene scene = test_street(150.0);
  CameraParams params;
  if (state.range(0) < 640) params.lens = LensParams::small();
  Camera camera(scene, params);
  std::uint32_t index = 0;
  for (auto _ : state) benchmark::DoNotOptimize(camera.take(body_at(index), index)), ++index;
}
BENCHMARK(BM_Frame)->Arg(640)->Arg(512)->Unit(benchmark::kMillisecond);

void BM_Remap(benchmark::State& state) {
  const Lens lens((LensParams()));
  cv::Mat x(480, 640, CV_32F), y(480, 640, CV_32F), from(480, 640, CV_32F, cv::Scalar(100)), to;
  for (int v = 0; v < 480; ++v)
    for (int u = 0; u < 640; ++u) {
      const Eigen::Vector2d ray = lens.ray_of({u, v});
      x.at<float>(v, u) = static_cast<float>(ray.x() * 370.0 + 319.5),
                     y.at<float>(v, u) = static_cast<float>(ray.y() * 370.0 + 239.5);
    }
  cv::setNumThreads(1);
  for (auto _ : state) cv::remap(from, to, x, y, cv::INTER_LINEAR);
}
BENCHMARK(BM_Remap)->Unit(benchmark::kMillisecond);

}  // namespace
