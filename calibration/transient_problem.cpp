#include "calibration/transient_problem.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <tuple>
#include <utility>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

Eigen::Index index(std::size_t k) { return static_cast<Eigen::Index>(k); }

// The steady law at the samples of a transient, and at the mean I of the step that leads to each.
struct Equilibrium {
  std::vector<double> at, step;
  Equilibrium(const Transient& t, const SteadySolidFraction& law) {
    for (std::size_t i = 0; i < t.s.size(); ++i) {
      at.push_back(law(t.I[i]));
      step.push_back(law(i == 0 ? t.I[0] : 0.5 * (t.I[i] + t.I[i - 1])));
    }
  }
};

TransientSolution evaluate(const DilationModel& model, const BinnedTransient& run, const Equilibrium& phi_eq,
                           std::span<const double> x, double offset, double phi_0, bool with_beta) {
  return model.evaluate({run.transient->s, phi_eq.at, phi_eq.step, run.transient->kind != "start_up"}, x,
                        offset, phi_0, with_beta);
}

// Misfit of one run, averaged over its bins, and the derivatives of the model by the coordinates, the offset
// and phi_0.
struct Misfit {
  Eigen::VectorXd misfit;
  Eigen::MatrixXd by;
  Misfit(const DilationModel& model, const BinnedTransient& run, const Equilibrium& phi_eq,
         std::span<const double> x, double offset, double phi_0) {
    const TransientSolution solution = evaluate(model, run, phi_eq, x, offset, phi_0, false);
    const std::size_t columns = x.size() + 2;
    misfit.resize(index(run.s.size()));
    by = Eigen::MatrixXd::Zero(index(run.s.size()), index(columns));
    for (std::size_t k = 0; k < run.s.size(); ++k) {
      const std::size_t from = run.bins.first[k], to = run.bins.first[k + 1];
      double phi = 0;
      for (std::size_t i = from; i < to; ++i) {
        phi += solution.phi[i];
        by.row(index(k)) += solution.phi_by.row(index(i));
      }
      const auto count = static_cast<double>(to - from);
      by.row(index(k)) /= count;
      misfit(index(k)) = run.phi[k] - phi / count;
    }
  }
};

double interpolated(const BinnedTransient& run, double s) {
  const auto above = std::upper_bound(run.s.begin(), run.s.end(), s) - run.s.begin();
  const auto k = static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(above, 1, std::ssize(run.s) - 1));
  const double w = (s - run.s[k - 1]) / (run.s[k] - run.s[k - 1]);
  return (1 - w) * run.phi[k - 1] + w * run.phi[k];
}

}  // namespace

Bins::Bins(std::size_t samples, long most) {
  const std::size_t n = std::min(samples, static_cast<std::size_t>(most));
  for (std::size_t k = 0; k <= n; ++k) first.push_back(k * samples / n);
}

std::vector<double> Bins::mean(std::span<const double> values) const {
  std::vector<double> means;
  for (std::size_t k = 0; k < size(); ++k) {
    double sum = 0;
    for (std::size_t i = first[k]; i < first[k + 1]; ++i) sum += values[i];
    means.push_back(sum / static_cast<double>(first[k + 1] - first[k]));
  }
  return means;
}

TransientProblem::TransientProblem(const SelectedData& selected, long bins)
    : conditions_(selected.conditions) {
  std::map<std::pair<std::size_t, double>, std::size_t> groups;
  for (const SelectedTransient& t : selected.transients) {
    const std::size_t group =
        groups.try_emplace({t.condition, t.transient->packing_friction}, groups.size()).first->second;
    const Bins means(t.transient->s.size(), bins);
    runs_.push_back(
        {t.transient, t.condition, group, means, means.mean(t.transient->s), means.mean(t.transient->phi)});
  }
  groups_ = groups.size();
}

/// The runs of one condition, for a given steady law and weights.
struct TransientProblem::Part {
  const DilationModel& model;
  bool offsets = true;
  std::vector<std::size_t> members;  ///< which runs
  std::vector<const BinnedTransient*> runs;
  std::vector<Equilibrium> phi_eq;
  std::vector<const Eigen::MatrixXd*> whiten;  ///< empty: none
  Eigen::Index rows = 0;

  struct Projected {
    Eigen::VectorXd residuals, constants;  ///< constants: the offset, then phi_0 of each run
    Eigen::MatrixXd jacobian;              ///< of the residuals by the coordinates
  };

  Projected project(std::span<const double> x) const {
    const Eigen::Index coordinates = index(x.size());
    Projected out;
    out.constants = Eigen::VectorXd::Zero(index(runs.size()) + 1);
    for (std::size_t k = 0; k < runs.size(); ++k) out.constants(index(k) + 1) = runs[k]->phi.front();
    out.residuals.resize(rows);
    out.jacobian.resize(rows, coordinates);
    // A linear model is solved by the first step and confirmed by the second; one with a kink at phi_eq needs
    // a few more until every sample has found its side. 1e-9 of phi is a millionth of its noise.
    for (int turn = 0;; ++turn) {
      const Eigen::VectorXd step = least_squares_step(x, out);
      out.constants += step;
      if (turn == 10 || !(step.lpNorm<Eigen::Infinity>() > 1e-9)) return out;
    }
  }

 private:
  /// Linearised at out.constants. Each run's phi_0 is projected out by itself, then the common offset.
  Eigen::VectorXd least_squares_step(std::span<const double> x, Projected& out) const {
    const Eigen::Index coordinates = index(x.size());
    Eigen::VectorXd by_offset(rows);
    Eigen::VectorXd step = Eigen::VectorXd::Zero(out.constants.size());
    std::vector<double> offset_in_phi_0;
    Eigen::Index at = 0;
    for (std::size_t k = 0; k < runs.size(); ++k) {
      const Misfit m(model, *runs[k], phi_eq[k], x, out.constants(0), out.constants(index(k) + 1));
      const Eigen::Index n = m.misfit.size();
      Eigen::MatrixXd all(n, coordinates + 3);
      all << m.by, m.misfit;
      if (!whiten.empty()) all = whiten[k]->triangularView<Eigen::Lower>() * all;
      const Eigen::VectorXd by_phi_0 = all.col(coordinates + 1);
      const double square = by_phi_0.squaredNorm();
      const Eigen::RowVectorXd along = by_phi_0.transpose() * all / square;
      all -= by_phi_0 * along;
      out.jacobian.middleRows(at, n) = -all.leftCols(coordinates);
      by_offset.segment(at, n) = all.col(coordinates);
      out.residuals.segment(at, n) = all.col(coordinates + 2);
      step(index(k) + 1) = along(coordinates + 2);
      offset_in_phi_0.push_back(along(coordinates));
      at += n;
    }
    const double square = by_offset.squaredNorm();
    if (!offsets || !(square > 0)) return step;  // none is allowed, or the law does not depend on it
    step(0) = by_offset.dot(out.residuals) / square;
    for (std::size_t k = 0; k < runs.size(); ++k) step(index(k) + 1) -= offset_in_phi_0[k] * step(0);
    const Eigen::RowVectorXd along = by_offset.transpose() * out.jacobian / square;
    out.residuals -= by_offset * step(0);
    out.jacobian -= by_offset * along;
    return step;
  }
};

TransientProblem::Part TransientProblem::part_of(std::size_t condition, const DilationModel& model,
                                                 const SteadySolidFraction& law, const Weights& weights,
                                                 const Choice& choice) const {
  Part part{model, choice.offsets, {}, {}, {}, {}, 0};
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    const BinnedTransient& run = runs_[r];
    if (run.condition != condition || run.group == choice.without_group ||
        (choice.only_group != none && run.group != choice.only_group))
      continue;
    part.members.push_back(r);
    part.runs.push_back(&run);
    part.phi_eq.emplace_back(*run.transient, law);
    if (!weights.empty()) part.whiten.push_back(&weights[r]);
    part.rows += index(run.s.size());
  }
  return part;
}

LeastSquaresProblem TransientProblem::problem(const DilationModel& model, const SteadySolidFraction& law,
                                              const Weights& weights, const std::vector<double>& start,
                                              const Choice& choice) const {
  LeastSquaresProblem p;
  p.name = "dilation";
  p.tolerance = 1e-7;  // of a chi2 of some thousand: a hundredth of a standard error
  // Where phi changes its side chi2 has kinks to be caught on; those of 88 runs were 0.8 deep, with s* off by
  // a fifth of its error.
  p.agreement = 1;
  for (std::size_t k = 0; k < start.size(); ++k) {
    const Coordinate& c = model.coordinates()[k];
    p.parameters.push_back({model.parameters()[k], start[k], c.lower, c.upper, false});
  }
  for (std::size_t c = 0; c < conditions_; ++c) {
    const auto part = std::make_shared<Part>(part_of(c, model, law, weights, choice));
    if (part->runs.empty()) continue;
    ResidualBlock block;
    for (std::size_t k = 0; k < start.size(); ++k) block.parameters.push_back(k);
    block.size = static_cast<std::size_t>(part->rows);
    // Ceres asks for the residuals first and for the Jacobian at the same place later.
    block.evaluate = [part, at = std::vector<double>(), projected = Part::Projected()](
                         std::span<const double> values, std::span<double> residuals,
                         std::span<double> jacobian) mutable {
      if (!std::equal(at.begin(), at.end(), values.begin(), values.end())) {
        at.assign(values.begin(), values.end());
        projected = part->project(values);
      }
      std::copy(projected.residuals.begin(), projected.residuals.end(), residuals.begin());
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      if (!jacobian.empty())
        Eigen::Map<RowMajor>(jacobian.data(), part->rows, index(values.size())) = projected.jacobian;
      return projected.residuals.allFinite();
    };
    p.blocks.push_back(std::move(block));
  }
  return p;
}

TransientConstants TransientProblem::constants(const DilationModel& model, const SteadySolidFraction& law,
                                               const Weights& weights, std::span<const double> x,
                                               const Choice& choice) const {
  TransientConstants out{std::vector<double>(conditions_, 0.0), std::vector<double>(runs_.size(), 0.0)};
  for (std::size_t c = 0; c < conditions_; ++c) {
    const Part part = part_of(c, model, law, weights, choice);
    if (part.runs.empty()) continue;
    const Part::Projected projected = part.project(x);
    out.offset[c] = projected.constants(0);
    for (std::size_t k = 0; k < part.members.size(); ++k)
      out.phi_0[part.members[k]] = projected.constants(index(k) + 1);
  }
  return out;
}

RunInformation::Normal RunInformation::normal(std::span<const double> times) const {
  std::map<std::size_t, Eigen::MatrixXd> conditions;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    Eigen::MatrixXd& sum = conditions[runs[r].condition];
    if (sum.size() == 0) sum = Eigen::MatrixXd::Zero(runs[r].products.rows(), runs[r].products.cols());
    sum += times[r] * runs[r].products;
  }
  const Eigen::Index n = runs.front().products.rows() - 2;
  Normal out{Eigen::MatrixXd::Zero(n, n), Eigen::VectorXd::Zero(n)};
  for (const auto& [condition, sum] : conditions) {
    out.square += sum.topLeftCorner(n, n);
    out.right += sum.col(n + 1).head(n);
    if (!(sum(n, n) > 0)) continue;  // the law knows no offset, or no run of this condition counts
    const Eigen::VectorXd by_offset = sum.col(n).head(n);
    out.square -= by_offset * by_offset.transpose() / sum(n, n);
    out.right -= by_offset * (sum(n, n + 1) / sum(n, n));
  }
  return out;
}

Eigen::VectorXd RunInformation::step(std::span<const double> times) const {
  const Normal n = normal(times);
  return n.square.ldlt().solve(n.right);
}

RunInformation TransientProblem::information(const DilationModel& model, const SteadySolidFraction& law,
                                             const Weights& weights, std::span<const double> x) const {
  const TransientConstants at = constants(model, law, weights, x, Choice());
  const Eigen::Index n = index(x.size());
  RunInformation out;
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    const CorrelatedResiduals left = residuals_of(r, model, law, x, at);
    Eigen::MatrixXd columns(left.residuals.size(), n + 3);
    columns << -left.jacobian, left.residuals;  // by coordinates, offset, phi_0
    if (!weights.empty()) columns = weights[r] * columns;
    const Eigen::VectorXd by_phi_0 = columns.col(n + 1);
    Eigen::MatrixXd rest(columns.rows(), n + 2);
    rest << columns.leftCols(n + 1), columns.col(n + 2);
    rest -= by_phi_0 * (by_phi_0.transpose() * rest / by_phi_0.squaredNorm());
    out.runs.push_back({runs_[r].condition, rest.transpose() * rest});
  }
  return out;
}

CorrelatedResiduals TransientProblem::residuals_of(std::size_t r, const DilationModel& model,
                                                   const SteadySolidFraction& law, std::span<const double> x,
                                                   const TransientConstants& constants) const {
  const BinnedTransient& run = runs_[r];
  Misfit m(model, run, Equilibrium(*run.transient, law), x, constants.offset[run.condition],
           constants.phi_0[r]);
  CorrelatedResiduals out;
  out.s = run.s;
  for (std::size_t k = 0; k < x.size(); ++k) out.parameters.push_back(k);
  out.parameters.push_back(x.size() + run.condition);
  out.parameters.push_back(x.size() + conditions_ + r);
  out.residuals = std::move(m.misfit);
  out.jacobian = -m.by;
  return out;
}

std::vector<CorrelatedResiduals> TransientProblem::residuals(const DilationModel& model,
                                                             const SteadySolidFraction& law,
                                                             std::span<const double> x,
                                                             const TransientConstants& constants) const {
  std::vector<CorrelatedResiduals> list;
  for (std::size_t r = 0; r < runs_.size(); ++r) list.push_back(residuals_of(r, model, law, x, constants));
  return list;
}

Matrix TransientProblem::covariance(const DilationModel& model,
                                    const std::vector<CorrelatedResiduals>& residuals, const Weights& weights,
                                    const std::vector<bool>& held) const {
  const std::size_t count = parameters(model);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(index(count), index(count));
  for (std::size_t r = 0; r < residuals.size(); ++r) {
    const Eigen::MatrixXd j = weights[r] * residuals[r].jacobian;
    const Eigen::MatrixXd jj = j.transpose() * j;
    for (Eigen::Index a = 0; a < jj.rows(); ++a)
      for (Eigen::Index b = 0; b < jj.cols(); ++b)
        normal(index(residuals[r].parameters[static_cast<std::size_t>(a)]),
               index(residuals[r].parameters[static_cast<std::size_t>(b)])) += jj(a, b);
  }
  std::vector<bool> fixed(count, false);
  std::copy(held.begin(), held.end(), fixed.begin());
  for (std::size_t k = held.size(); k < held.size() + conditions_; ++k)
    fixed[k] = normal(index(k), index(k)) == 0;  // the law knows no offset
  for (std::size_t k = 0; k < count; ++k) {
    if (!fixed[k]) continue;
    normal.row(index(k)).setZero(), normal.col(index(k)).setZero();
    normal(index(k), index(k)) = 1;
  }
  const Eigen::LDLT<Eigen::MatrixXd> factor(normal);
  if (factor.info() != Eigen::Success || !(factor.vectorD().minCoeff() > 0))
    throw IdentifiabilityError("dilation: the transients leave a combination of s*, offsets and phi_0 open");
  const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(index(count), index(count)));
  Matrix out(count, std::vector<double>(count));
  for (std::size_t a = 0; a < count; ++a)
    for (std::size_t b = 0; b < count; ++b)
      out[a][b] =
          fixed[a] || fixed[b] ? 0 : 0.5 * (inverse(index(a), index(b)) + inverse(index(b), index(a)));
  return out;
}

TransientProblem::Weights TransientProblem::whitening(const NoiseModel& noise) const {
  Weights list;
  for (const BinnedTransient& run : runs_) {
    if (!list.empty() && run.s == runs_[list.size() - 1].s)
      list.push_back(list.back());
    else
      list.push_back(noise.whitening(run.s));
  }
  return list;
}

TransientSolution TransientProblem::solution(const DilationModel& model, const SteadySolidFraction& law,
                                             std::span<const double> x, const TransientConstants& constants,
                                             std::size_t run) const {
  return evaluate(model, runs_[run], Equilibrium(*runs_[run].transient, law), x,
                  constants.offset[runs_[run].condition], constants.phi_0[run], true);
}

std::vector<std::vector<std::size_t>> TransientProblem::twins() const {
  std::vector<std::vector<std::size_t>> groups(groups_);
  for (std::size_t r = 0; r < runs_.size(); ++r) groups[runs_[r].group].push_back(r);
  return groups;
}

NoiseModel TransientProblem::noise_of_seeds(const std::vector<CorrelatedResiduals>& residuals,
                                            std::size_t coordinates) const {
  std::vector<CorrelatedResiduals> list;
  for (const std::vector<std::size_t>& group : twins()) {
    if (group.size() < 3) continue;
    double from = 0, to = std::numeric_limits<double>::infinity();
    for (const std::size_t r : group) {
      from = std::max(from, runs_[r].s.front());
      to = std::min(to, runs_[r].s.back());
    }
    const auto n = static_cast<double>(group.size());
    for (const std::size_t r : group) {
      std::vector<double> s, deviation, by_phi_0;
      for (std::size_t k = 0; k < runs_[r].s.size(); ++k) {
        if (runs_[r].s[k] < from || runs_[r].s[k] > to) continue;
        double others = 0;
        for (const std::size_t other : group)
          if (other != r) others += interpolated(runs_[other], runs_[r].s[k]) / (n - 1);
        s.push_back(runs_[r].s[k]);
        // The mean of the others has a variance of its own, 1/(n - 1) of one run's.
        deviation.push_back((runs_[r].phi[k] - others) * std::sqrt((n - 1) / n));
        by_phi_0.push_back(residuals[r].jacobian(index(k), index(coordinates) + 1));
      }
      if (s.size() < 10) continue;
      CorrelatedResiduals one;
      one.residuals = Eigen::Map<const Eigen::VectorXd>(deviation.data(), index(deviation.size()));
      one.jacobian = Eigen::Map<const Eigen::MatrixXd>(by_phi_0.data(), index(by_phi_0.size()), 1);
      one.parameters = {list.size()};
      one.s = std::move(s);
      list.push_back(std::move(one));
    }
  }
  if (list.size() < 8) return {0, 0, 0};
  return fit_noise(list, list.size());
}

}  // namespace dem2sph
