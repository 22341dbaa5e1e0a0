/** The JSON Schema of the configuration as a list of settings that a form can show. */

const GENERAL = "General";

/**
 * Every setting, in the order of the schema.
 *
 * @param {object} schema of the whole configuration
 * @returns {Array<{path: string, group: string, groupMeaning: string, title: string,
 *   meaning: string, unit: string, range: string, kind: string, schema: object, nullable: boolean}>}
 */
export function settings(schema) {
  const found = [];
  for (const [name, property] of Object.entries(schema.properties)) {
    const section = resolve(property, schema);
    if (section.type === "object") {
      for (const [key, leaf] of Object.entries(section.properties)) {
        const about = plain(section.description).replace(/\s*\([^)]*\)/g, "");
        found.push(setting(`${name}.${key}`, words(name), about, leaf));
      }
    } else {
      found.push(setting(name, GENERAL, "", section));
    }
  }
  return found;
}

function setting(path, group, groupMeaning, leaf) {
  const nullable = Boolean(leaf.anyOf);
  const schema = nullable ? { ...leaf, ...leaf.anyOf.find((one) => one.type !== "null") } : leaf;
  const meaning = plain(schema.description);
  const [bracket = "", unit = ""] = [...meaning.matchAll(/\s*\[([^\]]+)\]/g)].at(-1) ?? [];
  return {
    path,
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
