#include "core/files.h"

#include <sys/stat.h>

#include <fstream>

#include "core/error.h"
#include "core/json.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

std::size_t entries_in(const std::filesystem::path& folder) {
  return static_cast<std::size_t>(
      std::distance(std::filesystem::directory_iterator(folder), std::filesystem::directory_iterator()));
}

}  // namespace

TEST_CASE("an output appears whole or not at all") {
  const test::TempFolder folder;
  {
    AtomicOutput output(folder / "scene", AtomicOutput::Kind::folder, false);
    write_text(output.path() / "a.txt", "a");
    CHECK_FALSE(std::filesystem::exists(folder / "scene"));
  }
  CHECK(entries_in(folder.path()) == 0);
  {
    AtomicOutput output(folder / "scene", AtomicOutput::Kind::folder, false);
    write_text(output.path() / "a.txt", "a");
    output.commit();
  }
  CHECK(read_text(folder / "scene/a.txt") == "a");
  CHECK(entries_in(folder.path()) == 1);
}

TEST_CASE("an output that exists is replaced by force only") {
  const test::TempFolder folder;
  std::filesystem::create_directory(folder / "scene");
  write_text(folder / "scene/old.txt", "old");
  CHECK_THROWS_WITH(AtomicOutput(folder / "scene", AtomicOutput::Kind::folder, false),
                    Contains("exists already") && Contains("--force"));
  CHECK_THROWS_WITH(AtomicOutput(folder / "scene", AtomicOutput::Kind::folder, true),
                    Contains("not made by stuv"));
  write_text(folder / "scene/lightfield.json", "{}");
  AtomicOutput output(folder / "scene/", AtomicOutput::Kind::folder, true);
  write_text(output.path() / "new.txt", "new");
  CHECK(read_text(folder / "scene/old.txt") == "old");
  output.commit();
  CHECK_FALSE(std::filesystem::exists(folder / "scene/old.txt"));
  CHECK(read_text(folder / "scene/new.txt") == "new");
  CHECK(entries_in(folder.path()) == 1);
}

TEST_CASE("an output in a folder that is not there names it") {
  const test::TempFolder folder;
  CHECK_THROWS_WITH(check_output(folder / "nowhere/scene", false),
                    Contains("nowhere") && Contains("create it"));
}

TEST_CASE("natural order") {
  CHECK(natural_less("cam2", "cam10"));
  CHECK_FALSE(natural_less("cam10", "cam2"));
  CHECK(natural_less("cam01", "cam1"));
  CHECK_FALSE(natural_less("cam1", "cam01"));
  CHECK(natural_less("a", "ab"));
  CHECK_FALSE(natural_less("a", "a"));
  CHECK(natural_less("99999999999999999999998", "99999999999999999999999"));
}

TEST_CASE("manifests are checked for format and version") {
  const test::TempFolder folder;
  const auto file = folder / "rig.json";
  write_json(file, {{"format", "stuv.rig"}, {"version", 1}});
  CHECK(read_manifest(file, "stuv.rig", 1)["version"] == 1);
  CHECK_THROWS_WITH(read_manifest(file, "stuv.recording", 1), Contains("not a stuv.recording"));
  write_json(file, {{"format", "stuv.rig"}, {"version", 2}});
  CHECK_THROWS_WITH(read_manifest(file, "stuv.rig", 1), Contains("version 2") && Contains("newer stuv"));
  write_text(file, "{\"format\": \"stuv.rig\", ");
  CHECK_THROWS_WITH(read_manifest(file, "stuv.rig", 1), Contains("rig.json") && Contains("damaged"));
  CHECK_THROWS_WITH(read_manifest(folder / "none.json", "stuv.rig", 1), Contains("none.json"));
  write_text(file, "[1, 2]");
  CHECK_THROWS_AS(read_manifest(file, "stuv.rig", 1), Error);
}

TEST_CASE("JSON holds no Inf or NaN") {
  const test::TempFolder folder;
  write_json(folder / "a.json", {{"x", std::numeric_limits<double>::infinity()}, {"y", std::nan("")}});
  const Json json = read_json(folder / "a.json");
  CHECK(json["x"].is_null());
  CHECK(json["y"].is_null());
}

TEST_CASE("an error is one line") { CHECK(std::string(Error("a\nb", "c\n", "d").what()) == "a b: c ; d"); }

TEST_CASE("a name that is not UTF-8 is an error that names the file") {
  const test::TempFolder folder;
  CHECK_THROWS_WITH(write_json(folder / "a.json", {{"name", "\xe9"}}),
                    Contains("a.json") && Contains("UTF-8"));
}
