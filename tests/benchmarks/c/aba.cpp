// pinocchio's articulated-body algorithm in its own loop: forward dynamics of a serial arm, count times.
// Per joint: rotation (3, 3) row-major and translation of its placement, mass, centre of mass, inertia (3, 3) about it.
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/multibody.hpp>

extern "C" void aba_loop(long joints, const double *placement, const double *body, const double *gravity, long count,
                         const double *q, const double *qd, const double *tau, double *qdd) {
  using namespace pinocchio;
  using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  Model model;
  model.gravity.linear() = Eigen::Map<const Eigen::Vector3d>(gravity);
  JointIndex parent = 0;
  for (long i = 0; i < joints; i++) {
    const double *p = placement + 12 * i, *b = body + 13 * i;
    SE3 place(Eigen::Map<const RowMajor>(p), Eigen::Map<const Eigen::Vector3d>(p + 9));
    parent = model.addJoint(parent, JointModelRZ(), place, std::to_string(i));
    Inertia inertia(b[0], Eigen::Map<const Eigen::Vector3d>(b + 1), Eigen::Map<const RowMajor>(b + 4));
    model.appendBodyToJoint(parent, inertia, SE3::Identity());
  }
  Data data(model);
  using Vectors = Eigen::Map<const Eigen::VectorXd>;
  for (long k = 0; k < count; k++) {
    const long at = k * joints;
    aba(model, data, Vectors(q + at, joints), Vectors(qd + at, joints), Vectors(tau + at, joints), Convention::LOCAL);
    Eigen::Map<Eigen::VectorXd>(qdd + at, joints) = data.ddq;
  }
}
