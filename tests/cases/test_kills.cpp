// A sweep that is killed again and again, and one whose disk is full: what comes out in the end is what an
// undisturbed sweep gives, byte for byte in every dataset. Real LIGGGHTS, runs of a tenth of a second.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <hdf5.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <fstream>
#include <map>
#include <random>
#include <thread>

#include "sph/base/provenance.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

namespace fs = std::filesystem;
using test::content_of;
using test::put;

constexpr const char* case_text = R"([material]
d = "1 mm"
rho_s = "2500 kg/m^3"
grain_friction = 0.5
kappa = 300

[shear_cell]
on_failure = "retry"
retries = 1000        # a killed LIGGGHTS is tried again, as often as we kill it
grains = 250
length = 5
width = 5
core_margin = 1.5
time_limit = "60 s"

[shear_cell.steady]
I = [0.2, 0.5]
strain_dropped = 1
strain_used = 2
responses_dropped = 0.5
responses_used = 1
frames = 80

[shear_cell.start_up]
I = [0.2]
seeds = [1]
packing_friction = [0]
strain = 1
frames = 40
window = 0.1

[shear_cell.jump]
I_before = [0.2]
I = [0.5]
seeds = [1]
strain_before = 1
strain = 1
frames = 40
window = 0.1
)";

/// The bytes of every dataset of a file by its path; those below cost/ are seconds, which no two runs share.
std::map<std::string, std::string> datasets_of(const fs::path& path) {
  std::map<std::string, std::string> found;
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  EXPECT_GE(file, 0) << path;
  if (file < 0) return found;
  const auto visit = [](hid_t root, const char* name, const H5O_info_t* info, void* data) -> herr_t {
    if (info->type != H5O_TYPE_DATASET || std::string(name).starts_with("cost/")) return 0;
    std::string& bytes = (*static_cast<std::map<std::string, std::string>*>(data))[name];
    const hid_t set = H5Dopen2(root, name, H5P_DEFAULT);
    const hid_t type = H5Dget_type(set), space = H5Dget_space(set);
    const auto count = static_cast<std::size_t>(H5Sget_simple_extent_npoints(space));
    bytes.resize(count * H5Tget_size(type));
    if (count > 0) {
      EXPECT_GE(H5Dread(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, bytes.data()), 0) << name;
      if (H5Tis_variable_str(type) > 0) {  // pointers to text: the text is what counts
        std::string texts;
        for (std::size_t i = 0; i < count; ++i)
          texts += std::string(reinterpret_cast<char**>(bytes.data())[i]) + '\0';
        H5Dvlen_reclaim(type, space, H5P_DEFAULT, bytes.data());
        bytes = texts;
      }
    }
    H5Sclose(space), H5Tclose(type), H5Dclose(set);
    return 0;
  };
  EXPECT_GE(H5Ovisit(file, H5_INDEX_NAME, H5_ITER_INC, visit, &found), 0) << path;
  H5Fclose(file);
  return found;
}

void expect_same_datasets(const fs::path& path, const std::map<std::string, std::string>& reference) {
  const auto found = datasets_of(path);
  EXPECT_EQ(found.size(), reference.size());
  for (const auto& [name, bytes] : reference) {
    ASSERT_TRUE(found.contains(name)) << name;
    EXPECT_TRUE(found.at(name) == bytes) << name << " differs from that of an undisturbed sweep";
  }
}

/// Processes whose parent is `parent`.
std::vector<pid_t> children_of(pid_t parent) {
  std::vector<pid_t> children;
  for (const fs::directory_entry& entry : fs::directory_iterator("/proc")) {
    const std::string name = entry.path().filename();
    if (name.find_first_not_of("0123456789") != std::string::npos) continue;
    std::ifstream stat(entry.path() / "stat");
    std::string text;
    std::getline(stat, text);
    const std::size_t end = text.rfind(')');  // the program's name may hold anything
    if (end == std::string::npos) continue;   // it is gone already
    std::istringstream rest(text.substr(end + 1));
    char state = 0;
    pid_t its_parent = 0;
    if (rest >> state >> its_parent && its_parent == parent && state != 'Z')
      children.push_back(std::stoi(name));
  }
  return children;
}

class Kills : public test::Scratch {
 protected:
  void SetUp() override {
    if (!program_exists("liggghts")) GTEST_SKIP() << "LIGGGHTS is not installed (package liggghts)";
    put(in("case.toml"), case_text);
    ASSERT_EQ(finish(start("undisturbed", 2)), 0) << content_of(in("log"));
    reference_ = datasets_of(in("undisturbed/observables.h5"));
    // Every kind of run is there: hashes of two steady points and two transients among the datasets.
    ASSERT_GT(reference_.size(), 40U);
    ASSERT_EQ(reference_.at("steady/mu").size(), 2 * sizeof(double));
    ASSERT_TRUE(reference_.contains("transients/0001/beta"));
  }
  void TearDown() override {
    for (const pid_t pid : alive_) ::kill(pid, SIGKILL), ::waitpid(pid, nullptr, 0);
  }

  /// `dem2sph sweep` on the folder `name`, in a process group of its own; no file may grow beyond
  /// `file_size`.
  pid_t start(const std::string& name, int jobs, rlim_t file_size = RLIM_INFINITY) {
    const std::string case_file = in("case.toml"), output = in(name), log = in("log"),
                      threads = std::to_string(jobs);
    const pid_t pid = ::fork();
    if (pid == 0) {
      ::setpgid(0, 0);
      const int out = ::open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0644);
      ::dup2(out, 1), ::dup2(out, 2);
      const rlimit limit{file_size, file_size};
      if (file_size != RLIM_INFINITY) {
        ::setrlimit(RLIMIT_FSIZE, &limit);
        // MPI, with which LIGGGHTS is linked, would begin with files of some MB of shared memory.
        ::setenv("PMIX_MCA_gds", "hash", 1);
        ::setenv("OMPI_MCA_btl", "self", 1);
      }
      ::execl(DEM2SPH_PROGRAM, DEM2SPH_PROGRAM, "sweep", case_file.c_str(), "-o", output.c_str(), "--jobs",
              threads.c_str(), "-q", static_cast<char*>(nullptr));
      ::_exit(127);
    }
    ::setpgid(pid, pid);
    alive_.push_back(pid);
    return pid;
  }
  /// Waits for the end of a sweep; its exit code, or 128 + signal.
  int finish(pid_t pid) {
    int status = 0;
    ::waitpid(pid, &status, 0);
    std::erase(alive_, pid);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  bool has_ended(pid_t pid) {
    siginfo_t info{};
    return ::waitid(P_PID, static_cast<id_t>(pid), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
           info.si_pid == pid;
  }

  std::map<std::string, std::string> reference_;
  std::vector<pid_t> alive_;
};

TEST_F(Kills, FiftyKillsChangeNoByte) {
  // Two sweeps share a folder, one job each. Every 50 to 500 ms something dies of SIGKILL: a sweep alone, a
  // sweep with its whole process group, or one of the two engines. When a folder is finished, the next
  // begins.
  std::mt19937 random(20260101);
  int kills = 0, sweeps = 0, groups = 0, engines = 0, folders = 0;
  while (kills < 50) {
    const std::string name = "killed" + std::to_string(folders++);
    pid_t pids[2] = {start(name, 1), start(name, 1)};
    while (kills < 50) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50 + random() % 450));
      if (has_ended(pids[0]) && has_ended(pids[1])) break;
      pid_t& victim = pids[random() % 2];
      if (has_ended(victim)) continue;
      const unsigned what = random() % 4;
      if (what == 0) {
        ::kill(-victim, SIGKILL), ++groups;
      } else if (what == 1) {
        ::kill(victim, SIGKILL), ++sweeps;
      } else {
        const std::vector<pid_t> engine = children_of(victim);
        if (engine.empty()) continue;
        ::kill(engine[random() % engine.size()], SIGKILL), ++engines;
      }
      ++kills;
      if (what < 2) {
        EXPECT_EQ(finish(victim), 128 + SIGKILL);
        victim = start(name, 1);
      }
    }
    // Each may leave what the other works on (75), or lose the engine while it asks for its version and
    // styles (4); the same command once more then collects everything.
    for (const pid_t pid : pids) {
      const int code = finish(pid);
      EXPECT_TRUE(code == 0 || code == 75 || code == 4) << code << "\n" << content_of(in("log"));
    }
    ASSERT_EQ(finish(start(name, 2)), 0) << content_of(in("log"));
    expect_same_datasets(in(name) / "observables.h5", reference_);
  }
  std::printf("%d kills: %d sweeps, %d process groups, %d engines; %d folders\n", kills, sweeps, groups,
              engines, folders);
  EXPECT_GT(sweeps, 0);
  EXPECT_GT(groups, 0);
  EXPECT_GT(engines, 0);
}

TEST_F(Kills, AFullDiskLosesNothingThatWasDone) {
  // No file may grow beyond a limit, so that writing ends in the middle of a file as on a full disk: first
  // not even the list of runs fits, then verdicts do but neither restart files nor HDF5, then those but no
  // dumps, then the dumps of the short runs.
  std::string skipping = case_text;
  skipping.replace(skipping.find("\"retry\""), 7, "\"skip\"");
  skipping.erase(skipping.find("retries"), skipping.find("grains = ") - skipping.find("retries"));
  put(in("case.toml"), skipping);
  std::map<std::string, fs::file_time_type> done;
  std::size_t before = 0;
  for (const rlim_t limit : {4'000, 30'000, 100'000, 2'000'000}) {
    for (int again = 0; again < 2; ++again) {
      const int code = finish(start("full", 2, limit));
      EXPECT_TRUE(code == 1 || code == 4) << "limit " << limit << ": " << code << "\n"
                                          << content_of(in("log"));
    }
    for (const auto& [path, time] : done) EXPECT_EQ(fs::last_write_time(path), time) << path;
    if (!fs::exists(in("full/runs"))) continue;
    for (const fs::directory_entry& run : fs::directory_iterator(in("full/runs"))) {
      if (!run.is_directory()) continue;
      const fs::path verdict = run.path() / "done.json";
      if (fs::exists(verdict)) {
        EXPECT_NO_THROW(read_json(verdict)) << run.path();
        done[verdict] = fs::last_write_time(verdict);
      }
      fs::remove(run.path() / "failed.json");  // the next limit lets it try again
    }
    if (limit == 100'000) before = done.size();
  }
  EXPECT_EQ(before, 3U) << "both packings and the pre-shearing fit into 100 kB a file";
  EXPECT_GT(done.size(), before) << "the short transients fit into 2 MB a file";
  EXPECT_LT(done.size(), 7U) << "and the steady runs do not";
  ASSERT_EQ(finish(start("full", 2)), 0) << content_of(in("log"));
  for (const auto& [path, time] : done) EXPECT_EQ(fs::last_write_time(path), time) << path;
  expect_same_datasets(in("full") / "observables.h5", reference_);
}

}  // namespace
}  // namespace dem2sph
