/** A morph that is being put together, as plain data; it lives in the address of the page. */

export const FIRST = {
  source: { shape: "sphere" },
  via: [],
  target: { shape: "star" },
  methods: [],
  preset: "fast",
  name: "",
  overrides: {},
};

/** The draft in the query of an address. */
export function fromQuery({ source, via, target, methods, preset, name, overrides }) {
  return {
    source: shape(source) ?? FIRST.source,
    via: via?.split(",").map(shape).filter(Boolean) ?? FIRST.via,
    target: shape(target) ?? FIRST.target,
    methods: methods?.split(",").filter(Boolean) ?? [],
    preset: preset || FIRST.preset,
    name: name ?? "",
    overrides: settings(overrides),
  };
}

/** The query that stands for a draft. */
export function toQuery({ source, via, target, methods, preset, name, overrides }) {
  return {
    source: address(source),
    via: via.map(address).join(","),
    target: address(target),
    methods: methods.join(","),
    preset,
    name,
    overrides: Object.keys(overrides).length ? JSON.stringify(overrides) : "",
  };
}

/** A job as a draft: what its settings have that its preset has not. */
export function fromJob(job, config, preset) {
  const before = settingsOf(preset);
  const overrides = {};
  for (const [path, value] of Object.entries(settingsOf(config))) {
    if (path === "preset") continue;
    if (JSON.stringify(value) !== JSON.stringify(before[path])) overrides[path] = value;
  }
  const { source, via = [], target, method, name } = job;
  return { source, via, target, methods: [method], preset: job.preset, name, overrides };
}

/** Where and what to send: a job, or a sweep of several methods. */
export function toRequest({ source, via, target, methods, preset, name, overrides }) {
  const { seed, ...others } = overrides;
  const common = { preset, name, overrides: others };
  if (methods.length === 1) {
    const seeded = seed === undefined ? {} : { seed };
    const between = via.length ? { via } : {};
    return ["/jobs", { ...common, ...seeded, source, ...between, target, method: methods[0] }];
  }
  const seeded = seed === undefined ? {} : { seeds: [seed] };
  return ["/sweeps", { ...common, ...seeded, sources: [source], targets: [target], methods }];
}

/** Settings by dotted path, options of the method by theirs. */
export function settingsOf({ method: { name: _, ...options }, ...shared }) {
  return { ...flat(shared), ...flat(options) };
}

function flat(config, prefix = "") {
  return Object.entries(config).reduce((paths, [name, value]) => {
    const nested = value !== null && typeof value === "object" && !Array.isArray(value);
    return Object.assign(paths, nested ? flat(value, `${prefix}${name}.`) : { [prefix + name]: value });
  }, {});
}

function shape(text) {
  const [kind, ...rest] = (text ?? "").split(":");
  const name = rest.join(":");
  return name && (kind === "mesh" || kind === "shape") ? { [kind]: name } : null;
}

function address(one) {
  return one.mesh ? `mesh:${one.mesh}` : `shape:${one.shape}`;
}

function settings(text) {
  try {
    const found = JSON.parse(text);
    return found !== null && typeof found === "object" && !Array.isArray(found) ? found : {};
  } catch {
    return {};
  }
}
