// What several tests share: the message of an expected error, and a folder of a test's own.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "sph/base/errors.hpp"

namespace dem2sph::test {

/// Runs `action`, which must throw an E with E's own exit code, and returns its message.
template <class E, class Action>
std::string message_of(const Action& action) {
  try {
    action();
  } catch (const E& error) {
    return error.what();
  } catch (const std::exception& error) {
    ADD_FAILURE() << "another error than expected: " << error.what();
    return "";
  }
  ADD_FAILURE() << "no error was raised";
  return "";
}

inline bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

#define EXPECT_CONTAINS(text, part)                    \
  EXPECT_TRUE(dem2sph::test::contains((text), (part))) \
      << "\"" << (text) << "\" does not contain \"" << (part) << "\""

/// An empty folder that is removed with the test.
class Scratch : public testing::Test {
 protected:
  Scratch()
      : folder_(std::filesystem::path(testing::TempDir()) /
                ("dem2sph_" + std::to_string(::getpid()) + "_" +
                 testing::UnitTest::GetInstance()->current_test_info()->name())) {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~Scratch() override {
    std::error_code ignored;  // a destructor has nobody to tell
    std::filesystem::remove_all(folder_, ignored);
  }
  std::filesystem::path in(const std::string& name) const { return folder_ / name; }
  std::size_t files() const {
    std::size_t count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_)) count += entry.exists() ? 1 : 0;
    return count;
  }

  std::filesystem::path folder_;
};

inline std::string content_of(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  EXPECT_TRUE(file) << path;
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

inline void put(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

}  // namespace dem2sph::test
