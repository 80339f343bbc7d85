// A place to drive in: what is seen, what is driven on, and the ways through it.
#pragma once

#include "ground.hpp"
#include "scene.hpp"

#include <memory>
#include <string>
#include <vector>

namespace convoy::simulator {

struct World {
  Scene scene;
  std::shared_ptr<const Ground> ground;
  std::vector<Route> routes;  ///< the first is a closed loop, where there is one
  std::string attribution;    ///< to be shown with every picture of it; empty where nobody needs to be named
};

}  // namespace convoy::simulator
