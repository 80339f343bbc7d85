#include <convoy/config_error.hpp>
#include <convoy/vision/image_source.hpp>
#include <convoy/vision/kitti_sequence.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include <fstream>

namespace convoy {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using Status = SourceImage::Status;

class ImageSourceTest : public testing::Test {
 protected:
  ImageSourceTest()
      : folder_(testing::TempDir() + "convoy_images_" + testing::UnitTest::GetInstance()->current_test_info()->name()) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~ImageSourceTest() override { fs::remove_all(folder_); }

  /// A picture that is `grey` all over.
  void picture(const fs::path& name, int grey, int width = 64, int height = 48, int type = CV_8UC1) {
    fs::create_directories((folder_ / name).parent_path());
    ASSERT_TRUE(cv::imwrite((folder_ / name).string(), cv::Mat(height, width, type, cv::Scalar::all(grey))));
  }
  void text(const fs::path& name, const std::string& content) {
    std::ofstream(folder_ / name, std::ios::binary) << content;
  }

  template <class Open>
  void expect_refusal(const Open& open, const std::string& what) {
    try {
      open();
      ADD_FAILURE() << "no refusal that says: " << what;
    } catch (const ConfigError& error) {
      EXPECT_THAT(error.what(), HasSubstr(what));
    }
  }
  void expect_refusal_of_times(const std::string& content, const std::string& what) {
    text("times.txt", content);
    expect_refusal([&] { open_image_folder(folder_, {0.0, folder_ / "times.txt"}); }, what);
  }
  fs::path folder_;
};

/// Grey value in the middle of the next image, -1: refused, -2: end.
int next_grey(ImageSource& source, double stamp_s) {
  const SourceImage image = source.next();
  if (image.status == Status::end) return -2;
  EXPECT_NEAR(image.stamp_s, stamp_s, 1e-6);
  if (image.status == Status::refused) return -1;
  EXPECT_EQ(image.grey.type(), CV_8UC1);
  EXPECT_EQ(image.grey.cols, source.width());
  EXPECT_EQ(image.grey.rows, source.height());
  return image.grey.at<std::uint8_t>(image.grey.rows / 2, image.grey.cols / 2);
}

TEST_F(ImageSourceTest, FolderByNameAtARate) {
  picture("10.png", 30);
  picture("9.png", 20);
  picture("0008.PGM", 10);
  text("notes.txt", "no picture");
  const auto source = open_image_folder(folder_, {20.0, {}});
  EXPECT_EQ(source->width(), 64);
  EXPECT_EQ(source->height(), 48);
  EXPECT_EQ(next_grey(*source, 0.0), 10);
  EXPECT_EQ(next_grey(*source, 0.05), 20);
  EXPECT_EQ(next_grey(*source, 0.1), 30);
  EXPECT_EQ(next_grey(*source, 0.0), -2);
  EXPECT_EQ(next_grey(*source, 0.0), -2);
  EXPECT_EQ(source->refused(), 0U);
}

TEST_F(ImageSourceTest, ColourIsConverted) {
  picture("a.png", 100, 64, 48, CV_8UC3);
  picture("b.png", 200, 64, 48, CV_8UC4);
  const auto source = open_image_folder(folder_, {1.0, {}});
  EXPECT_EQ(next_grey(*source, 0.0), 100);
  EXPECT_EQ(next_grey(*source, 1.0), 200);
}

TEST_F(ImageSourceTest, FramesThatCannotBeUsedAreTold) {
  picture("0.png", 10);
  picture("1.png", 20, 32, 48);
  text("2.png", "not a picture at all");
  picture("3.png", 30, 64, 48, CV_16UC1);
  picture("4.png", 40);
  picture("5.png", 50);
  text("6.png", "");
  const auto source = open_image_folder(folder_, {10.0, {}});
  fs::remove(folder_ / "4.png");
  EXPECT_EQ(next_grey(*source, 0.0), 10);
  for (const char* why : {"1.png: is 32 x 48, those before it were 64 x 48", "2.png: is no picture that can be read",
                          "3.png: does not have 8 bits", "4.png: is not there"}) {
    const SourceImage image = source->next();
    EXPECT_EQ(image.status, Status::refused);
    EXPECT_TRUE(image.grey.empty());
    EXPECT_THAT(image.why, HasSubstr(why));
  }
  EXPECT_EQ(next_grey(*source, 0.5), 50);
  EXPECT_EQ(next_grey(*source, 0.6), -1);
  EXPECT_EQ(source->refused(), 5U);
}

TEST_F(ImageSourceTest, FolderThatIsNoneIsRefused) {
  expect_refusal([&] { open_image_folder(folder_ / "none", {10.0, {}}); }, "is no folder");
  expect_refusal([&] { open_image_folder(folder_, {10.0, {}}); }, "holds no picture");
  text("0.png", "damaged");
  expect_refusal([&] { open_image_folder(folder_, {10.0, {}}); }, "0.png: is no picture that can be read");
  picture("0.png", 1);
  expect_refusal([&] { open_image_folder(folder_, {0.0, {}}); }, "rate_hz must lie in (0, 10000]");
}

TEST_F(ImageSourceTest, TimesOfAFile) {
  picture("0.png", 10);
  picture("1.png", 20);
  const auto opened = [&](const std::string& content) {
    text("times.txt", content);
    return open_image_folder(folder_, {0.0, folder_ / "times.txt"});
  };
  const auto plain = opened("# stamps\n1.5\n2.5e0\n");
  EXPECT_EQ(next_grey(*plain, 1.5), 10);
  EXPECT_EQ(next_grey(*plain, 2.5), 20);
  const auto named = opened("7.0 1.png\n");
  EXPECT_EQ(next_grey(*named, 7.0), 20);
  EXPECT_EQ(next_grey(*named, 0.0), -2);
  const auto table = opened("step,frame,stamp_s,fnv1a64\n0,0,0.1,17\n1,1,0.2,18\n");
  EXPECT_EQ(next_grey(*table, 0.1), 10);
  EXPECT_EQ(next_grey(*table, 0.2), 20);
  const auto days = opened("2011-09-26 23:59:59.750000000\n2011-09-27 00:00:00.250000000\n");
  const double first_s = days->next().stamp_s;
  EXPECT_EQ(next_grey(*days, first_s + 0.5), 20);
}

TEST_F(ImageSourceTest, TimesThatCannotBeAreRefused) {
  picture("0.png", 10);
  picture("1.png", 20);
  expect_refusal_of_times("1.0\n", "has 1 stamps for the 2 pictures");
  expect_refusal_of_times("1.0\n1.0\n", "times.txt:2: the stamp is not later");
  expect_refusal_of_times("1.0\nlater\n", "times.txt:2: field 1 is 'later'");
  expect_refusal_of_times("1.0 0.png\n2.0\n", "times.txt:2: names no picture");
  expect_refusal_of_times("1.0 0.png\n2.0 7.png\n", "times.txt:2: '7.png' is not in");
  expect_refusal_of_times("1 2 3 4\n", "times.txt:1: the line must have a stamp");
  expect_refusal_of_times("2011-09-26 noon\n", "'noon' is no time of day");
  expect_refusal_of_times("stamp_s,frame\nnan,0\n1,1\n", "times.txt:2: stamp_s is 'nan'");
  expect_refusal_of_times("frame,stamp_s\n0\n", "times.txt:2: the line does not have the columns");
  expect_refusal_of_times("# nothing\n", "says nothing");
  expect_refusal([&] { open_image_folder(folder_, {0.0, folder_ / "none.txt"}); }, "none.txt: cannot be read");
}

TEST_F(ImageSourceTest, VideoFile) {
  const fs::path file = folder_ / "clip.avi";
  {
    cv::VideoWriter writer(file.string(), cv::CAP_OPENCV_MJPEG, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 25.0,
                           {64, 48});
    ASSERT_TRUE(writer.isOpened());
    for (const int grey : {40, 120, 200}) writer.write(cv::Mat(48, 64, CV_8UC3, cv::Scalar::all(grey)));
  }
  const auto source = open_video(file);
  EXPECT_EQ(source->width(), 64);
  EXPECT_NEAR(next_grey(*source, 0.0), 40, 3);
  EXPECT_NEAR(next_grey(*source, 0.04), 120, 3);
  EXPECT_NEAR(next_grey(*source, 0.08), 200, 3);
  EXPECT_EQ(next_grey(*source, 0.0), -2);
  const auto slow = open_video(file, {2.0, {}});
  next_grey(*slow, 0.0);
  EXPECT_NEAR(next_grey(*slow, 0.5), 120, 3);
  text("times.txt", "5.0\n6.5\n");
  const auto stamped = open_video(file, {0.0, folder_ / "times.txt"});
  EXPECT_NEAR(next_grey(*stamped, 5.0), 40, 3);
  EXPECT_NEAR(next_grey(*stamped, 6.5), 120, 3);
  EXPECT_EQ(next_grey(*stamped, 0.0), -2);
}

TEST_F(ImageSourceTest, VideoThatIsNoneIsRefused) {
  expect_refusal([&] { open_video(folder_ / "none.avi"); }, "is no file");
  expect_refusal([&] { open_video(folder_); }, "is no file");
  text("text.avi", "this is no video");
  expect_refusal([&] { open_video(folder_ / "text.avi"); }, "is no video that can be decoded");
}

const std::string projection = "700 0 32 0 0 700 24 0 0 0 1 0\n";

TEST_F(ImageSourceTest, KittiOdometry) {
  picture("image_0/000000.png", 10);
  picture("image_0/000001.png", 20);
  text("calib.txt", "P0: " + projection + "P1: " + projection);
  const KittiSequence at_rate = open_kitti(folder_);
  EXPECT_EQ(at_rate.calibration.width, 64);
  EXPECT_EQ(at_rate.calibration.fx, 700.0);
  EXPECT_EQ(at_rate.calibration.cy, 24.0);
  EXPECT_EQ(next_grey(*at_rate.images, 0.0), 10);
  EXPECT_EQ(next_grey(*at_rate.images, 0.1), 20);
  text("times.txt", "0.0\n1.036224e-01\n");
  const KittiSequence timed = open_kitti(folder_);
  EXPECT_EQ(next_grey(*timed.images, 0.0), 10);
  EXPECT_EQ(next_grey(*timed.images, 0.1036224), 20);
  text("calib.txt", projection + projection);  // as some copies have it
  EXPECT_EQ(open_kitti(folder_).calibration.fy, 700.0);
}

TEST_F(ImageSourceTest, KittiRaw) {
  picture("drive/image_00/data/0000000000.png", 10);
  text("drive/image_00/timestamps.txt", "2011-09-26 13:02:25.964389445\n");
  text("calib_cam_to_cam.txt", "calib_time: 09-Jan-2012 13:57:47\nS_00: 64 48\nP_rect_00: " + projection);
  const KittiSequence sequence = open_kitti(folder_ / "drive");
  EXPECT_EQ(sequence.calibration.cx, 32.0);
  EXPECT_EQ(sequence.images->next().status, Status::image);
}

TEST_F(ImageSourceTest, KittiThatIsNoneIsRefused) {
  expect_refusal([&] { open_kitti(folder_); }, "is no drive of KITTI");
  expect_refusal([&] { open_kitti(folder_, 4); }, "camera must lie in 0..3");
  picture("image_0/000000.png", 10);
  expect_refusal([&] { open_kitti(folder_); }, "calib.txt: cannot be read");
  text("calib.txt", "P1: " + projection);
  expect_refusal([&] { open_kitti(folder_); }, "has no row P0:");
  text("calib.txt", "P0: 1 2 3\n");
  expect_refusal([&] { open_kitti(folder_); }, "calib.txt:1: P0: must have 12 numbers");
  text("calib.txt", "\nP0: 700 0 500 0 0 700 24 0 0 0 1 0\n");
  expect_refusal([&] { open_kitti(folder_); }, "calib.txt:2: ");
}

}  // namespace
}  // namespace convoy
