// What is wrong with an XML file that does not parse, in words of the one who wrote it.
#pragma once

#include <string>

namespace tinyxml2 {
class XMLDocument;
}

namespace convoy::dds {

/// "not well-formed XML: ..."; the line is document.ErrorLineNum().
std::string xml_fault(const tinyxml2::XMLDocument& document);

}  // namespace convoy::dds
