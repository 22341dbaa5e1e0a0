/** Named materials of the surface: parameters of three's physical material. */

/**
 * All looks by name. `thickness` is a share of the size of what is shown; `opacity` stands for `transmission`
 * where refraction takes too long.
 */
export const LOOKS = {
  clay: { label: "Clay", color: "#bd8163", roughness: 0.92 },
  porcelain: { label: "Porcelain", color: "#f2efe9", roughness: 0.3, clearcoat: 0.3, clearcoatRoughness: 0.06 },
  jelly: {
    label: "Jelly",
    color: "#f0433a",
    roughness: 0.14,
    clearcoat: 0.4,
    clearcoatRoughness: 0.1,
    transmission: 0.75,
    thickness: 0.35,
    ior: 1.38,
    opacity: 0.82,
  },
  metal: { label: "Metal", color: "#c9ced6", metalness: 1, roughness: 0.24 },
  wax: {
    label: "Wax",
    color: "#e9c687",
    roughness: 0.5,
    sheen: 1,
    sheenRoughness: 0.45,
    sheenColor: "#ffb27a",
    emissive: "#5a2f12",
    emissiveIntensity: 0.35,
  },
  glass: {
    label: "Glass",
    color: "#f3fbfa",
    roughness: 0.03,
    transmission: 1,
    thickness: 0.3,
    ior: 1.46,
    opacity: 0.38,
  },
};
