#include "bench/chain/staged_run.h"

#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/files.h"
#include "libcalib/merge_session.h"
#include "libcalib/samples.h"
#include "tools/stopwatch.h"

namespace lacquer::bench {

StagedRun run_stages(const acquire::RigDescription& rig, std::shared_ptr<const brdf::Brdf> paint, const std::filesystem::path& folder, const fit::FitOptions& options) {
  acquire::Rig devices = acquire::open_rig(rig, std::move(paint));
  const acquire::Session session = acquire::capture_session(devices, rig, folder, {.command_line = "bench_chain"}, {});
  std::map<std::string, double> seconds;
  tools::Stopwatch watch;
  calib::Calibration calibration = calib::sensor_calibration(session);
  calib::merge_session(session, calibration, {});
  seconds["merge"] = watch.lap();
  calib::Tabulation tabulation = calib::tabulate_session(session, calibration, {}, {});
  seconds["tabulate"] = watch.lap();
  brdf::write_table(folder / "table.exr", tabulation.table);
  seconds["write table"] = watch.lap();
  const fit::FitResult fitted = fit::fit_table(tabulation.table, options);
  seconds["fit"] = watch.lap();
  return {std::move(tabulation.table), fitted.model, std::move(seconds)};
}

}  // namespace lacquer::bench
