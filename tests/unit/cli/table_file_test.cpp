#include "scenario/table_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <convoy/config_error.hpp>

#include "fake_run.hpp"

namespace convoy::cli {
namespace {

using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

constexpr TableFormat csv{.header = "t_s,name,value"};

/// Reads every field of every row.
void read_all(const std::filesystem::path& file, const TableFormat& format = csv) {
  for (TableFile table(file, format); table.next();) {
    (void)table.number(0);
    (void)table.optional_number(2);
  }
}

TEST(TableFile, ReadsRowsFieldsAndQuotedText) {
  const TemporaryFolder folder;
  test::write(folder / "a.csv", "t_s,name,value\n1.5,x,\n2,\"y, z\",-3e2\r\n");
  TableFile table(folder / "a.csv", csv);
  ASSERT_TRUE(table.next());
  EXPECT_EQ(table.number(0), 1.5);
  EXPECT_EQ(table.optional_number(2), std::nullopt);
  ASSERT_TRUE(table.next());
  EXPECT_EQ(table.text(1), "y, z");
  EXPECT_EQ(table.optional_number(2), -300.0);
  EXPECT_FALSE(table.next());
}

TEST(TableFile, RefusesWhatIsNotThereOrNotATable) {
  const TemporaryFolder folder;
  EXPECT_THAT(config_error_of([&] { read_all(folder / "none.csv"); }), HasSubstr("none.csv: no such file"));
  test::write(folder / "empty.csv", "");
  EXPECT_THAT(config_error_of([&] { read_all(folder / "empty.csv"); }), HasSubstr("empty.csv:1: the file is empty"));
  test::write(folder / "header.csv", "t_s,nome,value\n");
  EXPECT_THAT(config_error_of([&] { read_all(folder / "header.csv"); }), HasSubstr("must be 't_s,name,value'"));
}

struct BadTable {
  const char* rows;
  const char* message;
};

class BadTables : public testing::TestWithParam<BadTable> {};

TEST_P(BadTables, AreRefusedWithFileAndLine) {
  const TemporaryFolder folder;
  test::write(folder / "bad.csv", std::string("t_s,name,value\n1,a,2\n") + GetParam().rows);
  EXPECT_THAT(config_error_of([&] { read_all(folder / "bad.csv"); }), HasSubstr(GetParam().message));
}

INSTANTIATE_TEST_SUITE_P(TableFile, BadTables,
                         testing::Values(BadTable{"2,b,3", "bad.csv:3: the last line has no line end"},
                                         BadTable{"2,b\n", "bad.csv:3: the line has 2 fields; 3 are needed"},
                                         BadTable{"2,b,3,4\n", "bad.csv:3: the line has 4 fields"},
                                         BadTable{"\n", "bad.csv:3: the line has 1 fields"},
                                         BadTable{"2,b,3\n2x,b,3\n",
                                                  "bad.csv:4: field 1 is '2x'; it must be a finite number"},
                                         BadTable{"nan,b,3\n", "bad.csv:3: field 1 is 'nan'"},
                                         BadTable{"2,b,inf\n", "bad.csv:3: field 3 is 'inf'"},
                                         BadTable{",b,3\n", "bad.csv:3: field 1 is ''"},
                                         BadTable{"2,\"b,3\n", "bad.csv:3: a quotation mark is never closed"}));

TEST(TableFile, LeavesOutACutLastLineOnlyWhenTold) {
  const TemporaryFolder folder;
  test::write(folder / "cut.csv", "t_s,name,value\n1,a,2\n2,b");
  TableFile table(folder / "cut.csv", {.header = "t_s,name,value", .drop_cut_last_line = true});
  EXPECT_TRUE(table.next());
  EXPECT_FALSE(table.next());
  EXPECT_NE(config_error_of([&] { read_all(folder / "cut.csv"); }), "");
}

TEST(TableFile, ReadsBlankSeparatedTablesWithComments) {
  const TemporaryFolder folder;
  test::write(folder / "a.dat", "# a comment\n 7 \t 2.5 \n\n8 -1\n");
  TableFile table(folder / "a.dat", {.separator = ' ', .header = {}, .columns = 2});
  ASSERT_TRUE(table.next());
  EXPECT_EQ(table.small_number(0), 7U);
  EXPECT_EQ(table.number(1), 2.5);
  ASSERT_TRUE(table.next());
  EXPECT_THAT(config_error_of([&] { (void)table.whole_number(1); }), HasSubstr("a.dat:4: field 2 is '-1'"));
}

TEST(WriteTextFile, ReplacesInOneStepAndLeavesNothingElse) {
  const TemporaryFolder folder;
  write_text_file(folder / "sub/file.txt", "old");
  write_text_file(folder / "sub/file.txt", "new");
  EXPECT_EQ(test::read(folder / "sub/file.txt"), "new");
  const std::filesystem::directory_iterator entries(folder / "sub");
  EXPECT_EQ(std::distance(begin(entries), end(entries)), 1);
}

TEST(WriteTextFile, SaysWhyItCannot) {
  const TemporaryFolder folder;
  test::write(folder / "file", "");
  EXPECT_THAT(config_error_of([&] { write_text_file(folder / "file" / "below.txt", "x"); }),
              HasSubstr("below.txt: cannot be written"));
}

TEST(AppendNumber, ReadsBackAsTheSameDouble) {
  for (const double value : {0.1, -1.0 / 3.0, 1e-300, 1248444187.156, 2.0}) {
    std::string text;
    append_number(text, value);
    EXPECT_EQ(std::stod(text), value) << text;
  }
}

}  // namespace
}  // namespace convoy::cli
