// Files that are dropped or chosen: which of them is a map, which are scans, and what else to ask.

import { addMap, addScans } from "./actions.js";
import { $ } from "./dom.js";
import { change } from "./state.js";

const IMAGES = /\.(png|pgm|ppm|pnm|tiff?|bmp|webp|jpe?g)$/i;
const YAMLS = /\.ya?ml$/i;
const LOSSY = /\.jpe?g$/i;

/** Take files: a map first, as scans are looked for on it. */
export async function take(list) {
  change({ trouble: "" });
  const all = [...list], images = all.filter((f) => IMAGES.test(f.name));
  const yamls = [], scans = [];
  for (const file of all.filter((f) => !IMAGES.test(f.name))) {
    // `ros2 topic echo` writes YAML as well; that of a map names its image.
    const ofMap = YAMLS.test(file.name) && /^\s*image\s*:/m.test(await file.slice(0, 65536).text());
    (ofMap ? yamls : scans).push(file);
  }
  const [yaml] = yamls;
  if (yamls.length > 1 || scans.length > 1 || images.length > 1) {
    const many = [[yamls, "maps"], [scans, "files of scans"], [images, "images"]].find(([some]) => some.length > 1);
    change({ trouble: `Expected one map and one file of scans, got ${many[0].length} ${many[1]}.` });
    return;
  }
  if (yaml && !images.length) {
    change({ trouble: `${yaml.name}: drop the image that it names together with it.` });
    return;
  }
  if (images.length) {
    const [image] = images, reading = yaml ? {} : await askReading(image.name);
    if (!reading) return;
    if (LOSSY.test(image.name)) reading.allow_lossy = true;
    if (!(await addMap(image, yaml, reading))) return;
  }
  if (scans.length) await addScans(scans[0]);
}

/** Ask what an image does not say: {resolution, origin}; null if that is given up. */
function askReading(name) {
  const dialog = $("reading");
  $("reading-name").textContent = name;
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((done) => {
    dialog.addEventListener("close", () => {
      if (dialog.returnValue !== "ok") return done(null);
      const origin = ["x", "y", "yaw"].map((part) => $(`origin-${part}`).value || "0").join(",");
      return done({ resolution: $("resolution").value, origin });
    }, { once: true });
  });
}

/** Let files be dropped anywhere on the page, or chosen. */
export function acceptFiles() {
  const chooser = $("files");
  chooser.addEventListener("change", () => {
    take(chooser.files);
    chooser.value = "";
  });
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  document.addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) document.body.classList.remove("dropping");
  });
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    if (event.dataTransfer.files.length) take(event.dataTransfer.files);
  });
}
