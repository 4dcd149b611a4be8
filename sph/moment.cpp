// Inverse and least eigenvalue of the first moment of the kernel's gradient.
#include <Eigen/Dense>

#include "sph/passes.hpp"

namespace dem2sph {

template <int Dim>
Moment<Dim> invert_moment(const Gradient<Dim>& m) {
  Eigen::Matrix<double, Dim, Dim> matrix;
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) matrix(i, j) = 0.5 * (m(i, j) + m(j, i));  // symmetric but for rounding
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, Dim, Dim>> solver;
  solver.computeDirect(matrix);
  Moment<Dim> moment;
  moment.lambda = solver.eigenvalues()(0);
  const bool invertible = moment.lambda >= 0.75;
  const Eigen::Matrix<double, Dim, Dim> inverse =
      invertible ? Eigen::Matrix<double, Dim, Dim>(matrix.inverse())
                 : Eigen::Matrix<double, Dim, Dim>(Eigen::Matrix<double, Dim, Dim>::Identity());
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) moment.inverse(i, j) = inverse(i, j);
  return moment;
}

template Moment<2> invert_moment(const Gradient<2>&);
template Moment<3> invert_moment(const Gradient<3>&);

}  // namespace dem2sph
