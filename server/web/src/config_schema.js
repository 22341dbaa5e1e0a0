/** The JSON Schema of the configuration as a list of settings that a form can show. */

const GENERAL = "General";

/**
 * Every setting, in the order of the schema: those of all methods, then those of single ones.
 *
 * @param {object} schema of the whole configuration, in which `method` is a union of the options
 *   of all methods
 * @returns {Array<{path: string, methods: Set<string> | null, group: string, groupMeaning: string,
 *   title: string, meaning: string, unit: string, range: string, kind: string, schema: object,
 *   nullable: boolean}>} `methods` have the setting, all of them where it is null
 */
export function settings(schema) {
  const { method, ...shared } = schema.properties;
  const found = leaves(shared, schema, GENERAL);
  const ofMethods = new Map();
  for (const option of method.oneOf) {
    const { name, ...properties } = resolve(option, schema).properties;
    for (const leaf of leaves(properties, schema, "")) {
      const known = ofMethods.get(leaf.path);
      if (known) known.methods.add(name.const);
      else ofMethods.set(leaf.path, { ...leaf, methods: new Set([name.const]) });
    }
  }
  for (const leaf of ofMethods.values()) leaf.group ||= [...leaf.methods].map(words).join(", ");
  return [...found, ...ofMethods.values()];
}

/** Names of the methods that have an option of this name. */
export function methodsWith(option, schema) {
  const options = schema.properties.method.oneOf.map((one) => resolve(one, schema).properties);
  return new Set(options.filter((properties) => option in properties).map(({ name }) => name.const));
}

/** Settings of a section and of the sections in it; those right in it form a group of their own. */
function leaves(properties, schema, group, groupMeaning = "", prefix = "") {
  return Object.entries(properties).flatMap(([name, property]) => {
    const section = resolve(property, schema);
    const path = prefix + name;
    if (resolve(section.items ?? {}, schema).type === "object") return []; // no field holds these
    if (section.type !== "object") return [setting(path, group, groupMeaning, section)];
    const meaning = plain(section.description).replace(/\s*\([^)]*\)/g, "");
    return leaves(section.properties, schema, words(name), meaning, `${path}.`);
  });
}

function setting(path, group, groupMeaning, leaf) {
  const nullable = Boolean(leaf.anyOf);
  const schema = nullable ? { ...leaf, ...leaf.anyOf.find((one) => one.type !== "null") } : leaf;
  const meaning = plain(schema.description);
  const [bracket = "", unit = ""] = [...meaning.matchAll(/\s*\[([^\]]+)\]/g)].at(-1) ?? [];
  return {
    path,
    methods: null,
    group,
    groupMeaning,
    title: words(path.split(".").at(-1)),
    meaning: meaning.replace(bracket, ""),
    unit,
    range: range(schema),
    kind: schema.enum ? "choice" : schema.type,
    schema,
    nullable,
  };
}

/** The numbers that a setting may have, in words. */
export function range({ minimum, maximum, exclusiveMinimum, exclusiveMaximum }) {
  if (minimum !== undefined && maximum !== undefined) return `from ${minimum} to ${maximum}`;
  const bounds = [];
  if (minimum !== undefined) bounds.push(`at least ${minimum}`);
  if (exclusiveMinimum !== undefined) bounds.push(`above ${exclusiveMinimum}`);
  if (maximum !== undefined) bounds.push(`at most ${maximum}`);
  if (exclusiveMaximum !== undefined) bounds.push(`below ${exclusiveMaximum}`);
  return bounds.join(" and ");
}

function resolve(property, schema) {
  const [, name] = /^#\/\$defs\/(.+)$/.exec(property.$ref ?? "") ?? [];
  return name ? schema.$defs[name] : property;
}

function plain(description = "") {
  return description.replaceAll("`", "");
}

function words(name) {
  const text = name.replaceAll("_", " ");
  return text[0].toUpperCase() + text.slice(1);
}
