// SHA-256 against published vectors, and the promise of write_file_atomically: the old file or the new one,
// never half.
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>

#include <csignal>

#include "sph/base/provenance.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using test::message_of;

TEST(Sha256, PublishedVectors) {
  // FIPS 180-4 examples, and the empty text and the million 'a' of NIST's validation suite.
  EXPECT_EQ(sha256(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(sha256("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq"),
            "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  EXPECT_EQ(
      sha256(
          "abcdefghbcdefghicdefghijdefghijkefghijklfghijklmghijklmnhijklmnoijklmnopjklmnopqklmnopqrlmnopqrs"
          "mnopqrstnopqrstu"),
      "cf5b16a778af8380036ce59e7b0492370b249b11e8f07a51afac45037afee9d1");
  EXPECT_EQ(sha256(std::string(1000000, 'a')),
            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST(Sha256, LengthsAroundTheBlock) {
  // 'a' repeated, where the padding just fits, just does not, and starts a block; values of coreutils'
  // sha256sum.
  EXPECT_EQ(sha256(std::string(55, 'a')), "9f4390f8d30c2dd92ec9f095b65e2b9ae9b0a925a5258e241c9f1e910f734318");
  EXPECT_EQ(sha256(std::string(56, 'a')), "b35439a4ac6f0948b6d6f9e3c6af0f5f590ce20f1bde7090ef7970686ec6738a");
  EXPECT_EQ(sha256(std::string(63, 'a')), "7d3e74a05d7db15bce4ad9ec0658ea98e3f06eeecf16b4c6fff2da457ddc2f34");
  EXPECT_EQ(sha256(std::string(64, 'a')), "ffe054fe7ae0cb6dc65c3af9b61d5209f439851db43d0ba5997337df154668eb");
  EXPECT_EQ(sha256(std::string(65, 'a')), "635361c48bb9eab14198e76ea8ab7f1a41685d6ad62aa9146d301d4f17eb0ae0");
  EXPECT_EQ(sha256(std::string(119, 'a')),
            "31eba51c313a5c08226adf18d4a359cfdfd8d2e816b13f4af952f7ea6584dcfb");
  EXPECT_EQ(sha256(std::string(120, 'a')),
            "2f3d335432c70b580af0e8e1b3674a7c020d683aa5f73aaaedfdc55af904c21c");
  EXPECT_EQ(sha256(std::string("\0\xff", 2)),
            "06eb7d6a69ee19e5fbdf749018d3d2abfa04bcbd1365db312eb86dc7169389b8");  // bytes above 127 and zeros
                                                                                  // are bytes like others
}

using Files = test::Scratch;

TEST_F(Files, Sha256OfAFile) {
  test::put(in("text"), "abc");
  EXPECT_EQ(sha256_of_file(in("text")), sha256("abc"));
  EXPECT_CONTAINS(message_of<InputError>([&] { sha256_of_file(in("none")); }), in("none").string());
  EXPECT_CONTAINS(message_of<InputError>([&] { sha256_of_file(folder_); }), folder_.string());
}

TEST_F(Files, WriteReplacesTheWholeFile) {
  const std::string text("line\n\0after a zero", 18);
  write_file_atomically(in("out"), "a longer text that was there before");
  write_file_atomically(in("out"), text);
  EXPECT_EQ(test::content_of(in("out")), text);
  write_file_atomically(in("out"), "");
  EXPECT_EQ(test::content_of(in("out")), "");
  EXPECT_EQ(files(), 1u);
}

TEST_F(Files, AFullDiskLeavesTheOldFile) {
  write_file_atomically(in("out"), "old");
  // A limit on the size of files stands for the full disk; it is set in a child, since it cannot be taken
  // back.
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    std::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{4096, 4096};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    int code = 99;  // no error at all
    try {
      write_file_atomically(in("out"), std::string(100000, 'x'));
    } catch (const Error& error) {
      code =
          test::contains(error.what(), "cannot write: File too large") ? static_cast<int>(error.code()) : 98;
    } catch (...) {
      code = 97;
    }
    ::_exit(code);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), static_cast<int>(ExitCode::bug));
  EXPECT_EQ(test::content_of(in("out")), "old");
  EXPECT_EQ(files(), 1u) << "half a file was left behind";
}

TEST_F(Files, APlaceThatCannotBeWrittenIsNamed) {
  // Not by permissions, which root may ignore: a parent that does not exist, and one that is a file.
  test::put(in("file"), "old");
  for (const auto& path : {in("no/such/folder/out"), in("file/out")}) {
    const std::string message = message_of<Error>([&] { write_file_atomically(path, "new"); });
    EXPECT_CONTAINS(message, path.string());
    EXPECT_CONTAINS(message, "cannot create");
  }
  // A folder of that name refuses the rename; the temporary file must not stay.
  std::filesystem::create_directories(in("folder/inside"));
  EXPECT_CONTAINS(message_of<Error>([&] { write_file_atomically(in("folder"), "new"); }), "cannot rename");
  EXPECT_EQ(test::content_of(in("file")), "old");
  EXPECT_EQ(files(), 2u);
}

TEST_F(Files, JsonThatIsNoneIsAnInputError) {
  for (const char* text : {"", "{", "{\"a\": }", "[1, 2", "{\"a\": 1e999}", "\xff"}) {
    test::put(in("j.json"), text);
    EXPECT_CONTAINS(message_of<InputError>([&] { read_json(in("j.json")); }), in("j.json").string()) << text;
  }
  EXPECT_CONTAINS(message_of<InputError>([&] { read_json(in("none.json")); }), "cannot open");
  test::put(in("j.json"), "{\"a\": [1, 2.5]}");
  EXPECT_EQ(read_json(in("j.json")).at("a").at(1), 2.5);
}

TEST(Provenance, SaysWhoAndWhen) {
  const nlohmann::json p = provenance();
  for (const char* key : {"program", "version", "git_revision", "compiler", "host", "processor", "time_utc"})
    EXPECT_FALSE(p.at(key).get<std::string>().empty()) << key;
  EXPECT_EQ(p.at("time_utc").get<std::string>().size(), std::string("2026-01-31T12:00:00Z").size());
}

}  // namespace
}  // namespace dem2sph
