// MRPT's COccupancyGridMap2D: 8-bit log odds, every range inserted as a simple ray. The observations are made
// beforehand and the map has its size from the start, so only insertObservation is measured.
#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>
#include <mrpt/poses/CPose3D.h>

#include <algorithm>
#include <memory>

#include "workload.hpp"

using mrpt::maps::COccupancyGridMap2D;
using mrpt::obs::CObservation2DRangeScan;
using mrpt::poses::CPose3D;

// MRPT centres a scan on its sensor's x axis, and takes its aperture for N steps between N beams.
static double aperture_of(const Header& with) { return with.beams * with.angle_increment; }

static CPose3D pose_of(const Header& with, const Scan& scan) {
  const double middle = with.angle_min + 0.5 * aperture_of(with);
  return CPose3D(scan.x, scan.y, 0.0, scan.theta + middle, 0.0, 0.0);
}

// No ray is longer than `farthest`, and one that is as long marks no obstacle at its end.
static CObservation2DRangeScan observation_of(const Header& with, const Scan& scan, double farthest) {
  CObservation2DRangeScan observation;
  observation.aperture = static_cast<float>(aperture_of(with));
  observation.rightToLeft = true;
  observation.maxRange = static_cast<float>(2.0 * with.range_max);
  observation.resizeScan(scan.ranges.size());
  for (size_t k = 0; k < scan.ranges.size(); ++k) {
    double length = 0.0;
    const Kind kind = classify(with, scan.ranges[k], &length);
    observation.setScanRange(k, static_cast<float>(kind == NO_RETURN ? farthest : length));
    observation.setScanRangeValidity(k, kind != SKIPPED);
  }
  return observation;
}

int main(int, char** arguments) {
  const Workload work = load(arguments[1]);
  const double farthest = std::min(work.range_max, work.clear_range);
  std::vector<CPose3D> poses;
  std::vector<CObservation2DRangeScan> observations;
  for (const Scan& scan : work.scans) {
    poses.push_back(pose_of(work, scan));
    observations.push_back(observation_of(work, scan, farthest));
  }
  const double xmin = work.anchor_x + work.ix * work.resolution;
  const double ymin = work.anchor_y + work.iy * work.resolution;
  std::unique_ptr<COccupancyGridMap2D> map;
  const auto clear = [&] {
    // MRPT enlarges its map before a scan comes close to the edge; the margin spares it that.
    const double margin = 10.0;
    map = std::make_unique<COccupancyGridMap2D>(
        xmin - margin, xmin + work.width * work.resolution + margin, ymin - margin,
        ymin + work.height * work.resolution + margin, work.resolution);
    auto& options = map->insertionOptions;
    options.maxDistanceInsertion = static_cast<float>(farthest);
    options.maxOccupancyUpdateCertainty = static_cast<float>(work.p_occ);
    options.maxFreenessUpdateCertainty = static_cast<float>(1.0 - work.p_free);
    options.considerInvalidRangesAsFreeSpace = false;
    options.wideningBeamsWithDistance = false;
    options.decimation = 1;
  };
  const auto integrate = [&](size_t n) {
    map->insertObservation(observations[n], poses[n]);
    return -1;
  };
  const auto dump = [&](const std::string& path) {
    std::vector<double> log_odds;
    for (long iy = 0; iy < work.height; ++iy)
      for (long ix = 0; ix < work.width; ++ix) {
        const double x = xmin + (ix + 0.5) * work.resolution, y = ymin + (iy + 0.5) * work.resolution;
        // MRPT's probability is that of "free", and 0 log odds are what it begins with.
        const double p = map->getPos(static_cast<float>(x), static_cast<float>(y));
        const bool known = map->p2l(static_cast<float>(p)) != 0;
        log_odds.push_back(known ? std::log((1.0 - p) / p) : std::numeric_limits<double>::quiet_NaN());
      }
    write_map(path, work, log_odds);
  };
  return serve(work, clear, integrate, dump);
}
