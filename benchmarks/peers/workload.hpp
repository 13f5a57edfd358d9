// What the peers share: the workload, and the commands on standard input.
//
// A workload file is the Header, then for every scan x, y, theta as doubles and its ranges as floats. All
// cells that a workload can touch lie in `width` x `height` cells from (ix, iy) on.
#pragma once

#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <limits>
#include <string>
#include <vector>

struct Header {
  double resolution, range_min, range_max, alpha, clear_range, angle_min, angle_increment;
  double anchor_x, anchor_y, ix, iy, width, height, drop_outside;
  double d_free, d_occ, l_min, l_max, p_free, p_occ;
  double beams, scans;
};

struct Scan {
  double x, y, theta;
  std::vector<float> ranges;
};

struct Workload : Header {
  std::vector<Scan> scans;
};

inline void read(std::FILE* file, void* to, size_t bytes) {
  if (std::fread(to, 1, bytes, file) != bytes) {
    std::fputs("the workload file ends too early\n", stderr);
    std::exit(1);
  }
}

inline Workload load(const char* path) {
  std::FILE* file = std::fopen(path, "rb");
  if (!file) {
    std::perror(path);
    std::exit(1);
  }
  Workload work;
  read(file, static_cast<Header*>(&work), sizeof(Header));
  work.scans.resize(static_cast<size_t>(work.Header::scans));
  for (Scan& scan : work.scans) {
    read(file, &scan, 3 * sizeof(double));
    scan.ranges.resize(static_cast<size_t>(work.beams));
    read(file, scan.ranges.data(), scan.ranges.size() * sizeof(float));
  }
  std::fclose(file);
  return work;
}

// Which beams count, as REP-117 and the project's design say.
enum Kind { SKIPPED, NO_RETURN, HIT };

inline Kind classify(const Header& with, double r, double* length) {
  if (std::isnan(r) || r <= 0.0 || r < with.range_min) return SKIPPED;
  if (std::isfinite(r) && r > with.range_max * (1.0 + 1e-6)) return SKIPPED;
  if (r >= with.range_max) {
    *length = std::min(with.range_max, with.clear_range);
    return NO_RETURN;
  }
  if (r >= with.range_max - with.alpha / 2) {
    *length = std::min(r, with.clear_range);
    return NO_RETURN;
  }
  *length = r;
  return HIT;
}

// Log odds of a map, NaN where nothing was ever updated, row by row from the south.
inline void write_map(const std::string& path, const Header& with, const std::vector<double>& log_odds) {
  std::FILE* file = std::fopen(path.c_str(), "wb");
  const double head[4] = {with.ix, with.iy, with.width, with.height};
  if (!file || std::fwrite(head, sizeof(head), 1, file) != 1 ||
      std::fwrite(log_odds.data(), sizeof(double), log_odds.size(), file) != log_odds.size()) {
    std::perror(path.c_str());
    std::exit(1);
  }
  std::fclose(file);
}

// CPU time of this thread, s.
inline double cpu_time() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

// Answer `round`, which maps the whole workload afresh, `dump FILE` and `quit`, one line each.
//
// `clear` makes a fresh map, `integrate` adds the scan of an index to it and returns the number of cell
// updates, or -1 if nobody counts them; only that is measured. `dump` writes the map of the last round.
template <class Clear, class Integrate, class Dump>
int serve(const Workload& work, Clear clear, Integrate integrate, Dump dump) {
  std::cout << "{\"ready\": true}" << std::endl;
  std::string line;
  while (std::getline(std::cin, line) && line != "quit") {
    if (line == "round") {
      clear();
      std::vector<double> seconds;
      long updates = 0;
      for (size_t n = 0; n < work.scans.size(); ++n) {
        const double begin = cpu_time();
        updates += integrate(n);
        seconds.push_back(cpu_time() - begin);
      }
      std::cout << "{\"updates\": " << updates << ", \"us\": [";
      for (size_t n = 0; n < seconds.size(); ++n) std::cout << (n ? ", " : "") << 1e6 * seconds[n];
      std::cout << "]}" << std::endl;
    } else if (line.rfind("dump ", 0) == 0) {
      dump(line.substr(5));
      std::cout << "{\"dumped\": true}" << std::endl;
    }
  }
  return 0;
}
