// Particle <-> grid with momentum and mass as one vector, which the compiler keeps in a register.
#pragma once

#include "particle.h"

// GCC and Clang's portable vectors: momentum (velocity after the grid stage) in 0..2, mass in 3.
typedef float Node __attribute__((vector_size(16)));

inline void add(Node& sum, const Node& term) { sum += term; }

inline void to_velocity(Node& node) {
    node *= node[3] > MASS_FLOOR ? 1.0f / node[3] : 0.0f;
}

inline void scatter(const Stencil& s, const Vec& v, const Mat& B, float mass, Node* grid) {
    const float drag = (1.0f - DT * DRAG) * mass;
    const Node centre = {drag * v[0], drag * v[1], drag * v[2], mass};
    Node slope[3];
    for (int b = 0; b < 3; ++b) slope[b] = Node{B[0][b], B[1][b], B[2][b], 0.0f};
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            const float w = s.w[0][i] * s.w[1][j];
            const Node line = centre + s.d[0][i] * slope[0] + s.d[1][j] * slope[1];
            Node* node = grid + node_of(s, i, j);
            for (int k = 0; k < 4; ++k) node[k] += (w * s.w[2][k]) * (line + s.d[2][k] * slope[2]);
        }
}

inline void gather(const Stencil& s, const Node* grid, Vec& v, Mat& C) {
    Node value = {}, moment[3] = {};
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            const float w = s.w[0][i] * s.w[1][j];
            const Node* node = grid + node_of(s, i, j);
            Node line = {}, tilt = {};
            for (int k = 0; k < 4; ++k) {
                const Node share = s.w[2][k] * node[k];
                line += share;
                tilt += s.d[2][k] * share;
            }
            value += w * line;
            moment[0] += (w * s.d[0][i]) * line;
            moment[1] += (w * s.d[1][j]) * line;
            moment[2] += w * tilt;
        }
    for (int a = 0; a < 3; ++a) {
        v[a] = value[a];
        for (int b = 0; b < 3; ++b) C[a][b] = inertia * moment[b][a];
    }
}
