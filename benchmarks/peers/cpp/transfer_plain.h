// Particle <-> grid, written the plain way: one scalar sum per component.
#pragma once

#include "particle.h"

struct alignas(16) Node {
    float momentum[3];  // velocity after the grid stage
    float mass;
};

inline void add(Node& sum, const Node& term) {
    for (int a = 0; a < 3; ++a) sum.momentum[a] += term.momentum[a];
    sum.mass += term.mass;
}

inline void to_velocity(Node& node) {
    const float inverse = node.mass > MASS_FLOOR ? 1.0f / node.mass : 0.0f;
    for (int a = 0; a < 3; ++a) node.momentum[a] *= inverse;
}

inline void scatter(const Stencil& s, const Vec& v, const Mat& B, float mass, Node* grid) {
    const float drag = (1.0f - DT * DRAG) * mass;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            const float w = s.w[0][i] * s.w[1][j];
            float line[3];
            for (int a = 0; a < 3; ++a)
                line[a] = drag * v[a] + B[a][0] * s.d[0][i] + B[a][1] * s.d[1][j];
            Node* node = grid + node_of(s, i, j);
            for (int k = 0; k < 4; ++k) {
                const float weight = w * s.w[2][k];
                for (int a = 0; a < 3; ++a)
                    node[k].momentum[a] += weight * (line[a] + B[a][2] * s.d[2][k]);
                node[k].mass += weight * mass;
            }
        }
}

inline void gather(const Stencil& s, const Node* grid, Vec& v, Mat& C) {
    v = {};
    C = {};
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            const float w = s.w[0][i] * s.w[1][j];
            const Node* node = grid + node_of(s, i, j);
            float line[3] = {}, moment[3] = {};
            for (int k = 0; k < 4; ++k)
                for (int a = 0; a < 3; ++a) {
                    const float share = w * s.w[2][k] * node[k].momentum[a];
                    line[a] += share;
                    moment[a] += share * s.d[2][k];
                }
            for (int a = 0; a < 3; ++a) {
                v[a] += line[a];
                C[a][0] += inertia * line[a] * s.d[0][i];
                C[a][1] += inertia * line[a] * s.d[1][j];
                C[a][2] += inertia * moment[a];
            }
        }
}
