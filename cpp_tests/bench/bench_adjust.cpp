// Time of one adjustment: the library against Ceres with automatic derivatives, same cost, same start, one thread each.
//   bench_adjust DIR EXPORTER    DIR: problems of `EXPORTER --bench DIR`; EXPORTER: release build of examples/export_problem
//
// Ceres eliminates the views (DENSE_SCHUR) and starts each foot where it was last. Both run until nothing that matters is
// left: the library to a Newton decrement of 1e-6, Ceres to a relative change of the cost of 1e-10; the excess of
// its cost is printed. Rounds of the two take turns; medians of the rounds' medians.

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "build.hpp"

namespace {

constexpr int kRounds = 7;

double median(std::vector<double> x) {
  std::sort(x.begin(), x.end());
  return x[x.size() / 2];
}

struct Run {
  double seconds, cost;
  int iterations;
};

Run by_ceres(const Problem& problem) {
  Unknowns u = Unknowns::of(problem, problem.start, reference_of(problem));
  ceres::Problem ceres;
  const auto blocks = build(problem, u, Wrong::none, ceres);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 1000;
  options.function_tolerance = 1e-10;
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 0.0;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  auto* order = new ceres::ParameterBlockOrdering;
  for (double* b : blocks) order->AddElementToGroup(b, 1);
  // Blocks that are held have to be in some group as well.
  for (auto& s : {u.shape.data()})
    if (ceres.HasParameterBlock(s)) order->AddElementToGroup(s, 1);
  for (auto& own : u.own_shape)
    if (ceres.HasParameterBlock(own.data())) order->AddElementToGroup(own.data(), 1);
  for (size_t v = 0; v < u.pose.size(); ++v) order->AddElementToGroup(problem.in_plane[v] ? u.planar[v].data() : u.pose[v].data(), 0);
  options.linear_solver_ordering.reset(order);
  ceres::Solver::Summary summary;
  const auto begin = std::chrono::steady_clock::now();
  ceres::Solve(options, &ceres, &summary);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return {seconds, summary.final_cost, static_cast<int>(summary.iterations.size()) - 1};
}

// The library in a process of its own: seconds, decrement, linearisations.
Run by_library(const std::string& exporter, const std::string& name, int repeats) {
  const std::string command = "RAYON_NUM_THREADS=1 " + exporter + " --time " + name + " " + std::to_string(repeats);
  FILE* pipe = popen(command.c_str(), "r");
  Run run{};
  const int read = pipe ? std::fscanf(pipe, "%lf %lf %d", &run.seconds, &run.cost, &run.iterations) : 0;
  if (!pipe || pclose(pipe) != 0 || read != 3) throw std::runtime_error(command + ": failed");
  return run;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "bench_adjust DIR EXPORTER\n"), 2;
  std::printf("%-16s %12s %5s %12s %5s %10s %7s\n", "problem", "Ceres, ms", "it.", "spivcal, ms", "it.", "rel. cost", "ratio");
  for (const char* name : {"tangents_2x5", "tangents_2x30", "contours_2x5", "contours_2x30"}) {
    const Problem problem = Problem::read(std::string(argv[1]) + "/" + name + ".problem");
    std::vector<double> ceres, library;
    Run a{}, b{};
    for (int round = 0; round < kRounds; ++round) {
      a = by_ceres(problem);
      ceres.push_back(a.seconds);
      b = by_library(argv[2], name, 5);
      library.push_back(b.seconds);
    }
    const double x = median(ceres), y = median(library);
    std::printf("%-16s %12.2f %5d %12.3f %5d %10.1e %7.1f\n", name, 1e3 * x, a.iterations, 1e3 * y, b.iterations,
                a.cost / problem.cost - 1.0, x / y);
    std::fflush(stdout);
  }
  return 0;
}
