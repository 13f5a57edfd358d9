// The textbook's occupancy grid: float64 log odds in one dense array, and for every beam a list of the cells
// on Bresenham's line to its end (Thrun, Burgard & Fox 2005, tables 4.2 and 9.1). Given the same scans it
// must make the project's float64 map bit for bit, so it is compiled without fused multiply-add.
#include <algorithm>

#include "workload.hpp"

struct Cell {
  int i, j;
};

// Log odds of cells, [iy, ix].
struct Grid {
  long width, height;
  double d_free, d_occ, l_min, l_max;
  std::vector<double> log_odds;

  void clear() { log_odds.assign(width * height, 0.0); }

  bool holds(Cell cell) const { return cell.i >= 0 && cell.j >= 0 && cell.i < width && cell.j < height; }

  void add(Cell cell, double d) {
    double& l = log_odds[cell.j * width + cell.i];
    l = std::min(std::max(l + d, l_min), l_max);
  }
};

// The cells after the first one on Bresenham's line, the end included.
static std::vector<Cell> line(Cell from, Cell to) {
  const int di = std::abs(to.i - from.i), dj = std::abs(to.j - from.j);
  const int si = to.i > from.i ? 1 : -1, sj = to.j > from.j ? 1 : -1;
  int err = di - dj;
  const auto step = [&] {
    const int e2 = 2 * err;
    if (e2 > -dj) {
      err -= dj;
      from.i += si;
    }
    if (e2 < di) {
      err += di;
      from.j += sj;
    }
    return from;
  };
#ifdef SIZED
  // A list of the right size from the start: compilers make much better code of it.
  std::vector<Cell> cells(std::max(di, dj));
  for (Cell& cell : cells) cell = step();
#else
  std::vector<Cell> cells;
  while (from.i != to.i || from.j != to.j) cells.push_back(step());
#endif
  return cells;
}

static long integrate(const Workload& work, const Scan& scan, Grid& grid) {
  const auto cell_of = [&](double x, double y) {
    return Cell{static_cast<int>(std::floor((x - work.anchor_x) / work.resolution) - work.ix),
                static_cast<int>(std::floor((y - work.anchor_y) / work.resolution) - work.iy)};
  };
  const Cell start = cell_of(scan.x, scan.y);
  long updates = 0;
  for (size_t k = 0; k < scan.ranges.size(); ++k) {
    double length;
    const Kind kind = classify(work, scan.ranges[k], &length);
    if (kind == SKIPPED) continue;
    const double bearing = scan.theta + (work.angle_min + k * work.angle_increment);
    const Cell end = cell_of(scan.x + length * std::cos(bearing), scan.y + length * std::sin(bearing));
    if (work.drop_outside && !(grid.holds(start) && grid.holds(end))) continue;
    const std::vector<Cell> cells = line(start, end);
    if (cells.empty()) continue;
    for (size_t n = 0; n + 1 < cells.size(); ++n) grid.add(cells[n], grid.d_free);
    grid.add(cells.back(), kind == HIT ? grid.d_occ : grid.d_free);
    updates += static_cast<long>(cells.size());
  }
  return updates;
}

int main(int, char** arguments) {
  const Workload work = load(arguments[1]);
  const long width = static_cast<long>(work.width), height = static_cast<long>(work.height);
  Grid grid{width, height, work.d_free, work.d_occ, work.l_min, work.l_max, {}};
  const auto dump = [&](const std::string& path) {
    // A second map, whose cells count their updates, tells which were ever updated.
    Grid counts{width, height, 1.0, 1.0, 0.0, 1e300, {}};
    counts.clear();
    for (const Scan& scan : work.scans) integrate(work, scan, counts);
    for (size_t n = 0; n < counts.log_odds.size(); ++n)
      if (counts.log_odds[n] == 0.0) grid.log_odds[n] = std::numeric_limits<double>::quiet_NaN();
    write_map(path, work, grid.log_odds);
  };
  return serve(
      work, [&] { grid.clear(); }, [&](size_t n) { return integrate(work, work.scans[n], grid); }, dump);
}
