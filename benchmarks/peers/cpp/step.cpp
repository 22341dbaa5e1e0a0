// One MPM forward step in C++: float32, OpenMP, one private grid per thread, no intrinsics.
// Compiled and called by cpp_step.py; the constants arrive as -D definitions from scene.py.

#include <vector>

#include <omp.h>

#include TRANSFER

constexpr int node_count = NODES_PER_AXIS * NODES_PER_AXIS * NODES_PER_AXIS;

extern "C" void mpm_step(int particle_count, float mass, const float* volume,
                         const Vec* x, const Vec* v, const Mat* C, const Mat* F, const Mat* U,
                         Vec* x_next, Vec* v_next, Mat* C_next, Mat* F_next) {
    static std::vector<Node> grids[THREADS];

#pragma omp parallel num_threads(THREADS)
    {
        std::vector<Node>& own = grids[omp_get_thread_num()];
        own.assign(node_count, Node{});

#pragma omp for schedule(static)
        for (int p = 0; p < particle_count; ++p) {
            Mat B = kirchhoff(F[p] + U[p]);
            for (int i = 0; i < 3; ++i)
                for (int j = 0; j < 3; ++j)
                    B[i][j] = mass * C[p][i][j] - inertia * DT * volume[p] * B[i][j];
            scatter(stencil_of(x[p]), v[p], B, mass, own.data());
        }

#pragma omp for schedule(static)
        for (int i = 0; i < node_count; ++i) {
            for (int t = 1; t < THREADS; ++t) add(grids[0][i], grids[t][i]);
            to_velocity(grids[0][i]);
        }

#pragma omp for schedule(static)
        for (int p = 0; p < particle_count; ++p) {
            gather(stencil_of(x[p]), grids[0].data(), v_next[p], C_next[p]);
            const Mat A = F[p] + U[p];
            for (int i = 0; i < 3; ++i) {
                x_next[p][i] = x[p][i] + DT * v_next[p][i];
                for (int j = 0; j < 3; ++j) {
                    float updated = A[i][j];
                    for (int k = 0; k < 3; ++k) updated += DT * C_next[p][i][k] * A[k][j];
                    F_next[p][i][j] = (1.0f - SMOOTHING) * updated + SMOOTHING * F[p][i][j];
                }
            }
        }
    }
}
