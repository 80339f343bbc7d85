#include <convoy/dds/xml_fault.hpp>

#include <tinyxml2.h>

namespace convoy::dds {
namespace {

const char* words_of(tinyxml2::XMLError error) {
  switch (error) {
    case tinyxml2::XML_ERROR_EMPTY_DOCUMENT: return "the file is empty, or no XML at all";
    case tinyxml2::XML_ERROR_MISMATCHED_ELEMENT:
      return "an element is closed by another name or not at all; write <name .../> or <name>...</name>";
    case tinyxml2::XML_ERROR_PARSING_ELEMENT: return "an element is cut or malformed; write <name entry=\"value\"/>";
    case tinyxml2::XML_ERROR_PARSING_ATTRIBUTE: return "an entry is malformed; write name=\"value\", each name once";
    case tinyxml2::XML_ERROR_PARSING_COMMENT: return "a comment has no end; close it with -->";
    case tinyxml2::XML_ERROR_PARSING_DECLARATION:
      return "the declaration is malformed; write <?xml version=\"1.0\"?> as the first line, or leave it out";
    case tinyxml2::XML_ERROR_PARSING_CDATA: return "a CDATA section has no end; close it with ]]>";
    case tinyxml2::XML_ERROR_PARSING_TEXT: return "text stands outside of every element; take it out";
    case tinyxml2::XML_ELEMENT_DEPTH_EXCEEDED: return "elements are nested too deeply";
    default: return "the file ends before its elements are closed, or holds something that is no XML";
  }
}

}  // namespace

std::string xml_fault(const tinyxml2::XMLDocument& document) {
  return std::string("not well-formed XML: ") + words_of(document.ErrorID());
}

}  // namespace convoy::dds
