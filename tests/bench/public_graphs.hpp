// Public pose graphs, where they are on this machine.
#pragma once

#include <convoy/geometry/se2.hpp>
#include <convoy/solver/g2o.hpp>
#include <convoy/solver/pose_graph.hpp>

#include <benchmark/benchmark.h>

#include <filesystem>
#include <memory>
#include <string>

#include "../support/data_folder.hpp"

namespace convoy::bench {

/// The file of the bench's graph, which its argument numbers.
inline std::string graph_name(const benchmark::State& state) {
  static const char* const names[] = {"input_M3500_g2o.g2o", "kitti_05.g2o", "kitti_06.g2o", "kitti_07.g2o",
                                      "kitti_09.g2o"};
  return names[state.range(0)];
}

/// The graph of the bench, placed by its odometry; or nothing, and the bench skipped.
inline std::unique_ptr<PoseGraph<SE2>> public_graph(benchmark::State& state) {
  const std::string name = graph_name(state);
  const std::filesystem::path path = test::data_folder() / "pose_graphs/single" / name;
  if (!std::filesystem::exists(path)) {
    state.SetLabel("skipped: no pose_graphs/single/" + name + "; set CONVOY_DATA_DIR");
    for (auto _ : state) {
    }
    return nullptr;
  }
  auto graph = std::make_unique<PoseGraph<SE2>>(pose_graph_se2(read_g2o(path)));
  graph->poses = composed_poses(*graph);
  return graph;
}

/// What published costs refer to.
inline PoseGraphParams g2o_residual() {
  PoseGraphParams params;
  params.residual = PoseResidual::g2o;
  return params;
}

}  // namespace convoy::bench
