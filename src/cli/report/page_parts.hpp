// What all pages have in common: head, looks, and the cells of tables. XHTML, self-contained.
#pragma once

#include <string>

namespace convoy::cli {

/// Everything up to and including <body>, with the looks. Ends with page_end().
std::string page_begin(const std::string& title);
std::string page_end();

/// One cell of a table, aligned to the left or, as figures are, to the right.
std::string text_cell(const std::string& text);
std::string cell(const std::string& text);
/// One to the left that stays on one line.
std::string whole_cell(const std::string& text);

}  // namespace convoy::cli
