#include <convoy/exchange/message.hpp>

namespace convoy {

const char* to_string(Integrity integrity) {
  switch (integrity) {
    case Integrity::unaligned: return "UNALIGNED";
    case Integrity::ok: return "OK";
    case Integrity::suspect: return "SUSPECT";
  }
  return "unknown";
}

}  // namespace convoy
