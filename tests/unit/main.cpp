// Runs the tests, and fails if there was none to run: a filter that matches nothing, or an executable that lost its
// cases, must not look like success.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>

int main(int argc, char** argv) {
  testing::InitGoogleMock(&argc, argv);
  const int result = RUN_ALL_TESTS();
  if (testing::UnitTest::GetInstance()->test_to_run_count() == 0) {
    std::printf("no test was selected\n");
    return 1;
  }
  return result;
}
