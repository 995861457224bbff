// A BAL file minimised by Ceres: ceres_bundle FILE SOLVER THREADS ITERATIONS FUNCTION_TOLERANCE
// SOLVER: dense_schur, sparse_schur or iterative_schur. Without arguments it prints the version of Ceres.
#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

struct ImagePoint {
    double x, y;
    template <class T>
    bool operator()(const T* image, const T* point, T* residual) const {
        T p[3];
        ceres::AngleAxisRotatePoint(image, point, p);
        for (int k = 0; k < 3; ++k) p[k] += image[3 + k];
        const T u = -p[0] / p[2], v = -p[1] / p[2], r2 = u * u + v * v;
        const T scale = image[6] * (1.0 + r2 * (image[7] + image[8] * r2));
        residual[0] = scale * u - x;
        residual[1] = scale * v - y;
        return true;
    }
};

int main(int argc, char** argv) {
    if (argc == 1) return std::puts(CERES_VERSION_STRING), 0;
    if (argc != 6) return std::fprintf(stderr, "FILE SOLVER THREADS ITERATIONS FUNCTION_TOLERANCE\n"), 2;
    std::FILE* file = std::fopen(argv[1], "r");
    int images, points, rays;
    if (!file || std::fscanf(file, "%d %d %d", &images, &points, &rays) != 3) return 2;
    std::vector<int> image(rays), point(rays);
    std::vector<ImagePoint> measured(rays);
    for (int k = 0; k < rays; ++k)
        if (std::fscanf(file, "%d %d %lf %lf", &image[k], &point[k], &measured[k].x, &measured[k].y) != 4) return 2;
    std::vector<double> unknowns(9 * images + 3 * points);
    for (double& value : unknowns)
        if (std::fscanf(file, "%lf", &value) != 1) return 2;

    double* first_point = unknowns.data() + 9 * images;
    ceres::Problem problem;
    auto* order = new ceres::ParameterBlockOrdering;
    for (int k = 0; k < rays; ++k)
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<ImagePoint, 2, 9, 3>(new ImagePoint(measured[k])), nullptr,
            &unknowns[9 * image[k]], first_point + 3 * point[k]);
    for (int k = 0; k < points; ++k) order->AddElementToGroup(first_point + 3 * k, 0);
    for (int k = 0; k < images; ++k) order->AddElementToGroup(&unknowns[9 * k], 1);

    ceres::Solver::Options options;
    const std::string solver = argv[2];
    options.linear_solver_type = solver == "dense_schur"    ? ceres::DENSE_SCHUR
                                 : solver == "sparse_schur" ? ceres::SPARSE_SCHUR
                                                            : ceres::ITERATIVE_SCHUR;
    options.preconditioner_type = ceres::SCHUR_JACOBI;
    options.linear_solver_ordering.reset(order);
    options.num_threads = std::atoi(argv[3]);
    options.max_num_iterations = std::atoi(argv[4]);
    options.function_tolerance = std::atof(argv[5]);
    options.gradient_tolerance = options.parameter_tolerance = 1e-16;
    options.minimizer_progress_to_stdout = true;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    std::cout << summary.FullReport() << std::endl;
    std::printf("final cost %.12e\n", summary.final_cost);
}
