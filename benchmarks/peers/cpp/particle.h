// What concerns one particle alone: its stencil and its stress.
#pragma once

#include <algorithm>
#include <cmath>

constexpr float inertia = 3.0f;  // c of the cubic B-spline

struct Vec {
    float a[3];
    float operator[](int i) const { return a[i]; }
    float& operator[](int i) { return a[i]; }
};

struct Mat {
    float a[3][3];
    const float* operator[](int i) const { return a[i]; }
    float* operator[](int i) { return a[i]; }
};

struct Stencil {
    int corner;     // index of the first of the 4x4x4 nodes
    float w[3][4];  // weights per axis
    float d[3][4];  // node minus particle per axis
};

inline Stencil stencil_of(const Vec& x) {
    Stencil s;
    int base[3];
    for (int axis = 0; axis < 3; ++axis) {
        const float u = x[axis] - GRID_MIN;
        // A stencil moved back onto the grid gives zero weight to the nodes out of reach.
        base[axis] = std::clamp(int(std::floor(u)) - 1, 0, NODES_PER_AXIS - 4);
        for (int i = 0; i < 4; ++i) {
            const float d = float(base[axis] + i) - u;
            const float outer = std::max(2.0f - std::fabs(d), 0.0f);
            const float inner = std::max(1.0f - std::fabs(d), 0.0f);
            s.d[axis][i] = d;
            s.w[axis][i] = (outer * outer * outer - 4.0f * inner * inner * inner) * (1.0f / 6.0f);
        }
    }
    s.corner = (base[0] * NODES_PER_AXIS + base[1]) * NODES_PER_AXIS + base[2];
    return s;
}

inline int node_of(const Stencil& s, int i, int j) {
    return s.corner + (i * NODES_PER_AXIS + j) * NODES_PER_AXIS;
}

inline Mat operator+(const Mat& F, const Mat& U) {
    Mat A;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) A[i][j] = F[i][j] + U[i][j];
    return A;
}

inline float determinant(const Mat& A) {
    return A[0][0] * (A[1][1] * A[2][2] - A[1][2] * A[2][1])
         - A[0][1] * (A[1][0] * A[2][2] - A[1][2] * A[2][0])
         + A[0][2] * (A[1][0] * A[2][1] - A[1][1] * A[2][0]);
}

// Neo-Hookean P A^T = mu (A A^T - I) + lambda ln(det A) I.
inline Mat kirchhoff(const Mat& A) {
    const float pressure = LAMBDA * std::log(determinant(A)) - MU;
    Mat tau;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const float product = A[i][0] * A[j][0] + A[i][1] * A[j][1] + A[i][2] * A[j][2];
            tau[i][j] = MU * product + (i == j ? pressure : 0.0f);
        }
    return tau;
}
