// Sentences of the service name arguments in backquotes; people read the controls of the page instead.

const CONTROLS = {
  near: "the arrow", region: "the region", clearance: "“Free space around the sensor”", flipped: "“Upside down”",
  range_max: "“Reach”", range_scale: "“1 in the file is”", sensor: "“Sensor on the robot”", topic: "“Laser”",
};
const READING = { topic: CONTROLS.topic }; // while a file is read: the others act later
const METRES = ["range_max", "range_scale"];
const TAKES = { // commands that take an option
  allow_lossy: "open", fov: "open", negate: "open", range_max: "open", sensor: "open",
  height: "convert", max_bad: "convert", odom: "convert",
};
const OPTIONS = { fov: "fov-deg", index: "scans-index", theta_step: "theta-step-deg" }; // that are called otherwise
const ARGUMENT = /`([a-z_]+)(?:=([^`\s]+))?`/g;
const ADVICE = /\b(try|leave out|pass) (`[^`]+`(?: `[^`]+`)*)/gi;

/** An argument as an option of a command. */
function option(name, value) {
  const flag = `--${value === "False" ? "no-" : ""}${(OPTIONS[name] ?? name).replaceAll("_", "-")}`;
  return value === undefined || value === "True" || value === "False" ? flag : `${flag} ${value}`;
}

/** What to do with a control, instead of passing an argument, or leaving it `out`. */
function deed(control, out, name, value) {
  if (name === "flipped") return `${out ? "untick" : "tick"} ${control}`;
  return value ? `set ${control} to ${value}${METRES.includes(name) ? " m" : ""}` : `fill in ${control}`;
}

/** A sentence of the service in the words of the page; of one about the `reading` of a file only some are. */
export function inWords(text, reading = false) {
  const controls = reading ? READING : CONTROLS;
  const advised = text.replace(ADVICE, (whole, verb, list) => {
    const given = [...list.matchAll(ARGUMENT)].map(([, ...argument]) => argument);
    if (!given.every(([name]) => controls[name])) return whole;
    const said = given.map(([name, value]) => deed(controls[name], /out/i.test(verb), name, value)).join(" and ");
    return /^[A-Z]/.test(verb) ? said[0].toUpperCase() + said.slice(1) : said;
  });
  const other = [...advised.matchAll(ARGUMENT)].find(([, name]) => TAKES[name] && !controls[name]);
  const more = other ? ` The page has no control for it; imgloc ${TAKES[other[1]]} takes ${option(other[1], other[2])}.` : "";
  const named = advised.replace(ARGUMENT, (_, name, value) => controls[name] ?? option(name, value));
  const said = named.replace(/^(\w+)(?=: got )/, (key) => controls[key] ?? key);
  return more ? said.replace(/\.?$/, ".") + more : said;
}
