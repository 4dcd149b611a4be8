// The solver against NIST's certified nonlinear regressions (Statistical Reference Datasets), and what it
// refuses.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <complex>

#include "calibration/least_squares.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

using Complex = std::complex<double>;

struct Certified {
  std::string name;
  Complex (*model)(const std::vector<Complex>& b, double x);
  std::vector<double> x, y;
  std::vector<std::vector<double>> starts;  // both of NIST's: far and near
  std::vector<double> values, standard_deviations;
  double sum_of_squares;
};

std::vector<Certified> nist() {
  const std::vector<double> misra_x{77.6,  114.9, 141.1, 190.8, 239.9, 289.0, 332.8,
                                    378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0};
  const std::vector<double> misra_y{10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02,
                                    44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78};
  return {
      {"Misra1a",
       [](const std::vector<Complex>& b, double x) { return b[0] * (1.0 - std::exp(-b[1] * x)); },
       misra_x,
       misra_y,
       {{500, 0.0001}, {250, 0.0005}},
       {2.3894212918e+02, 5.5015643181e-04},
       {2.7070075241e+00, 7.2668688436e-06},
       1.2455138894e-01},
      {"Misra1d",
       [](const std::vector<Complex>& b, double x) { return b[0] * b[1] * x / (1.0 + b[1] * x); },
       misra_x,
       misra_y,
       {{500, 0.0001}, {450, 0.0003}},
       {4.3736970754e+02, 3.0227324449e-04},
       {3.6489174345e+00, 2.9334354479e-06},
       5.6419295283e-02},
      {"DanWood",
       [](const std::vector<Complex>& b, double x) { return b[0] * std::pow(Complex(x), b[1]); },
       {1.309, 1.471, 1.490, 1.565, 1.611, 1.680},
       {2.138, 3.421, 3.597, 4.340, 4.882, 5.660},
       {{1, 5}, {0.7, 4}},
       {7.6886226176e-01, 3.8604055871e+00},
       {1.8281973860e-02, 5.1726610913e-02},
       4.3173084083e-03},
      {"Rat42",
       [](const std::vector<Complex>& b, double x) { return b[0] / (1.0 + std::exp(b[1] - b[2] * x)); },
       {9, 14, 21, 28, 42, 57, 63, 70, 79},
       {8.930, 10.800, 18.590, 22.330, 39.350, 56.110, 61.730, 64.620, 67.080},
       {{100, 1, 0.1}, {75, 2.5, 0.07}},
       {7.2462237576e+01, 2.6180768402e+00, 6.7359200066e-02},
       {1.7340283401e+00, 8.8295217536e-02, 3.4465663377e-03},
       8.0565229338e+00},
      {"BoxBOD",
       [](const std::vector<Complex>& b, double x) { return b[0] * (1.0 - std::exp(-b[1] * x)); },
       {1, 2, 3, 5, 7, 10},
       {109, 149, 149, 191, 213, 224},
       {{100, 0.75}},  // from NIST's far start, (1, 1), the minimum lies at infinity
       {2.1380940889e+02, 5.4723748542e-01},
       {1.2354515176e+01, 1.0455993237e-01},
       1.1680088766e+03},
      {"Thurber",
       [](const std::vector<Complex>& b, double x) {
         return (b[0] + x * (b[1] + x * (b[2] + x * b[3]))) / (1.0 + x * (b[4] + x * (b[5] + x * b[6])));
       },
       {-3.067, -2.981, -2.921, -2.912, -2.840, -2.797, -2.702, -2.699, -2.633, -2.481,
        -2.363, -2.322, -1.501, -1.460, -1.274, -1.212, -1.100, -1.046, -0.915, -0.714,
        -0.566, -0.545, -0.400, -0.309, -0.109, -0.103, 0.010,  0.119,  0.377,  0.790,
        0.963,  1.006,  1.115,  1.572,  1.841,  2.047,  2.200},
       {80.574,   84.248,   87.264,   87.195,   89.076,   89.608,   89.868,   90.101,   92.405,   95.854,
        100.696,  101.060,  401.672,  390.724,  567.534,  635.316,  733.054,  759.087,  894.206,  990.785,
        1090.109, 1080.914, 1122.643, 1178.351, 1260.531, 1273.514, 1288.339, 1327.543, 1353.863, 1414.509,
        1425.208, 1421.384, 1442.962, 1464.350, 1468.705, 1447.894, 1457.628},
       {{1000, 1000, 400, 40, 0.7, 0.3, 0.03}, {1300, 1500, 500, 75, 1, 0.4, 0.05}},
       {1.2881396800e+03, 1.4910792535e+03, 5.8323836877e+02, 7.5416644291e+01, 9.6629502864e-01,
        3.9797285797e-01, 4.9727297349e-02},
       {4.6647963344e+00, 3.9571156086e+01, 2.8698696102e+01, 5.5675370270e+00, 3.1333340687e-02,
        1.4984928198e-02, 6.5842344623e-03},
       5.6427082397e+03}};
}

// All data in one block, with the derivative by the complex step: exact to rounding, as Jets are.
LeastSquaresProblem problem_of(const Certified& c, const std::vector<double>& start) {
  LeastSquaresProblem problem;
  problem.name = c.name;
  ResidualBlock block;
  for (std::size_t k = 0; k < start.size(); ++k) {
    problem.parameters.push_back({fmt::format("b{}", k + 1), start[k]});
    block.parameters.push_back(k);
  }
  block.size = c.x.size();
  block.evaluate = [&c](std::span<const double> b, std::span<double> r, std::span<double> j) {
    for (std::size_t i = 0; i < c.x.size(); ++i) {
      std::vector<Complex> at(b.begin(), b.end());
      r[i] = c.y[i] - c.model(at, c.x[i]).real();
      for (std::size_t k = 0; k < b.size() && !j.empty(); ++k) {
        constexpr double step = 1e-100;
        at[k] += Complex(0, step);
        j[i * b.size() + k] = -c.model(at, c.x[i]).imag() / step;
        at[k] = b[k];
      }
    }
    return true;
  };
  problem.blocks.push_back(block);
  return problem;
}

double digits(double value, double certified) { return -std::log10(std::abs(value / certified - 1) + 1e-16); }

TEST(LeastSquares, NistCertifiedValues) {
  for (const Certified& c : nist())
    for (const std::vector<double>& start : c.starts) {
      SCOPED_TRACE(c.name);
      const LeastSquaresResult result = solve_least_squares(problem_of(c, start));
      const double variance = result.chi2 / static_cast<double>(result.degrees_of_freedom);
      EXPECT_GE(digits(result.chi2, c.sum_of_squares), 6);
      for (std::size_t k = 0; k < start.size(); ++k) {
        EXPECT_GE(digits(result.values[k], c.values[k]), 6) << "b" << k + 1;
        // Certified to 11 digits, but the deviations depend on the Jacobian at values that are good to six.
        EXPECT_GE(digits(std::sqrt(variance * result.covariance[k][k]), c.standard_deviations[k]), 5)
            << "b" << k + 1;
      }
    }
}

LeastSquaresProblem line(const std::vector<double>& x, const std::vector<double>& y) {
  LeastSquaresProblem problem;
  problem.name = "line";
  problem.parameters = {{"a", 0.5, 0, 10}, {"b", 0.5, 0, 10}};
  ResidualBlock block;
  block.parameters = {0, 1};
  block.size = x.size();
  block.evaluate = [x, y](std::span<const double> p, std::span<double> r, std::span<double> j) {
    for (std::size_t i = 0; i < x.size(); ++i) {
      r[i] = y[i] - p[0] - p[1] * x[i];
      if (!j.empty()) j[2 * i] = -1, j[2 * i + 1] = -x[i];
    }
    return true;
  };
  problem.blocks.push_back(block);
  return problem;
}

TEST(LeastSquares, LineHasItsTextbookCovariance) {
  const LeastSquaresResult result = solve_least_squares(line({0, 1, 2, 3}, {1, 3, 5, 7}));
  EXPECT_NEAR(result.values[0], 1, 1e-12);
  EXPECT_NEAR(result.values[1], 2, 1e-12);
  // (J^T J)^-1 with n = 4, sum x = 6, sum x^2 = 14: determinant 20.
  EXPECT_NEAR(result.covariance[0][0], 14.0 / 20, 1e-13);
  EXPECT_NEAR(result.covariance[0][1], -6.0 / 20, 1e-13);
  EXPECT_NEAR(result.covariance[1][1], 4.0 / 20, 1e-13);
  EXPECT_EQ(result.degrees_of_freedom, 2);
  EXPECT_EQ(result.singular_values.size(), 2u);
}

TEST(LeastSquares, ParameterAtABoundIsFixedAndTheRestSolvedAgain) {
  // The line falls, b >= 0 holds it level: a is then the mean, and b has no error.
  const LeastSquaresResult result = solve_least_squares(line({0, 1, 2, 3}, {4, 3, 2, 1}));
  EXPECT_FALSE(result.at_bound[0]);
  EXPECT_TRUE(result.at_bound[1]);
  EXPECT_EQ(result.values[1], 0);
  // The search ends where chi2 = 5 changes by less than 1e-15 of itself: sqrt(5e-15) standard errors of 0.5.
  EXPECT_NEAR(result.values[0], 2.5, 1e-7);
  EXPECT_NEAR(result.covariance[0][0], 0.25, 1e-13);  // of a mean of four, not of an intercept (0.7)
  EXPECT_EQ(result.covariance[1][1], 0);
  EXPECT_EQ(result.degrees_of_freedom, 3);
}

TEST(LeastSquares, DataThatCannotTellTheParametersAreAnError) {
  EXPECT_THROW(solve_least_squares(line({1}, {1})), IdentifiabilityError);
  EXPECT_THROW(solve_least_squares(line({}, {})), IdentifiabilityError);
  EXPECT_THROW(solve_least_squares(line({2, 2, 2}, {1, 1.1, 0.9})), IdentifiabilityError);
  EXPECT_THROW(solve_least_squares(line({0, 0, 0}, {1, 1.1, 0.9})), IdentifiabilityError);
  try {
    solve_least_squares(line({2, 2, 2}, {1, 1.1, 0.9}));
  } catch (const IdentifiabilityError& error) {
    EXPECT_NE(std::string(error.what()).find("line: the data leave a combination of a, b open"),
              std::string::npos)
        << error.what();
    EXPECT_EQ(error.code(), ExitCode::not_identifiable);
  }
}

TEST(LeastSquares, StartsThatFailAreCountedAndBadStartsRefused) {
  LeastSquaresProblem problem = line({0, 1, 2}, {1, 2, 3});
  const auto inner = problem.blocks[0].evaluate;
  problem.blocks[0].evaluate = [inner](std::span<const double> p, std::span<double> r, std::span<double> j) {
    return p[0] < 5 && inner(p, r, j);
  };
  const std::vector<std::vector<double>> more{{8, 1}, {0.1, 3}};
  const LeastSquaresResult result = solve_least_squares(problem, more);
  EXPECT_EQ(result.starts, 3);
  EXPECT_EQ(result.converged, 2);
  EXPECT_EQ(result.agreed, 2);

  problem.parameters[0].start = 7;
  EXPECT_THROW(solve_least_squares(problem), IdentifiabilityError);  // no start has a value
  problem.parameters[0].start = 11;
  EXPECT_THROW(solve_least_squares(problem), Error);  // outside its bounds
  problem.parameters[0].start = std::nan("");
  EXPECT_THROW(solve_least_squares(problem), Error);
}

}  // namespace
}  // namespace dem2sph
