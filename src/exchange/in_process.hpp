// An exchange inside one process: deterministic, on the caller's clock, with a seeded impairment per receiver.
#pragma once

#include <convoy/exchange/impairment.hpp>
#include <convoy/exchange/submap_exchange.hpp>

#include <memory>
#include <vector>

namespace convoy {

/// A broadcast medium. Bytes are counted about as a wire would, once for all who hear. Endpoints may live in different
/// threads; what comes out is repeatable only if one thread drives them all.
template <class G>
class InProcessNetwork {
 public:
  InProcessNetwork();
  ~InProcessNetwork();

  /// A new endpoint. It gets what is sent from now on (no history: late joiners rely on repair). It may outlive the
  /// network and may be destroyed at any time. `impairment.seed` is mixed with the endpoint's number.
  std::unique_ptr<SubmapExchange<G>> join(const Impairment& impairment = {});

 private:
  struct Medium;
  class Endpoint;
  std::shared_ptr<Medium> medium_;
};

}  // namespace convoy
