// OctoMap's OcTree in the plane: insertPointCloud at the same resolution, one layer of cells.
#include <octomap/octomap.h>

#include <algorithm>
#include <memory>

#include "workload.hpp"

// Points in the map frame; one farther away than `farthest` clears its ray that far and marks no obstacle.
static octomap::Pointcloud cloud_of(const Header& with, const Scan& scan, double farthest, float z) {
  octomap::Pointcloud cloud;
  for (size_t k = 0; k < scan.ranges.size(); ++k) {
    double length;
    const Kind kind = classify(with, scan.ranges[k], &length);
    if (kind == SKIPPED) continue;
    if (kind == NO_RETURN) length = farthest + 1.0;
    const double bearing = scan.theta + (with.angle_min + k * with.angle_increment);
    cloud.push_back(static_cast<float>(scan.x + length * std::cos(bearing)),
                    static_cast<float>(scan.y + length * std::sin(bearing)), z);
  }
  return cloud;
}

int main(int, char** arguments) {
  const Workload work = load(arguments[1]);
  const double farthest = std::min(work.range_max, work.clear_range);
  const float z = static_cast<float>(work.resolution / 2.0);
  std::vector<octomap::Pointcloud> clouds;
  for (const Scan& scan : work.scans) clouds.push_back(cloud_of(work, scan, farthest, z));
  std::unique_ptr<octomap::OcTree> tree;
  const auto clear = [&] {
    tree = std::make_unique<octomap::OcTree>(work.resolution);
    tree->setProbHit(work.p_occ);
    tree->setProbMiss(work.p_free);
    tree->setClampingThresMin(1.0 / (1.0 + std::exp(-work.l_min)));
    tree->setClampingThresMax(1.0 / (1.0 + std::exp(-work.l_max)));
  };
  const auto integrate = [&](size_t n) {
    const Scan& scan = work.scans[n];
    const octomap::point3d sensor(static_cast<float>(scan.x), static_cast<float>(scan.y), z);
    tree->insertPointCloud(clouds[n], sensor, farthest);
    return -1;
  };
  const auto dump = [&](const std::string& path) {
    std::vector<double> log_odds(work.width * work.height, std::numeric_limits<double>::quiet_NaN());
    for (auto leaf = tree->begin_leafs(); leaf != tree->end_leafs(); ++leaf) {
      const long ix = std::floor((leaf.getX() - work.anchor_x) / work.resolution) - work.ix;
      const long iy = std::floor((leaf.getY() - work.anchor_y) / work.resolution) - work.iy;
      if (ix >= 0 && iy >= 0 && ix < work.width && iy < work.height)
        log_odds[iy * static_cast<long>(work.width) + ix] = leaf->getLogOdds();
    }
    write_map(path, work, log_odds);
  };
  return serve(work, clear, integrate, dump);
}
