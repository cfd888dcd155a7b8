// Files that are dropped or chosen: which of them is a map, which are scans, and what else to ask.

import { addMap, addScans } from "./actions.js";
import { $ } from "./dom.js";
import { change } from "./state.js";

const IMAGES = /\.(png|pgm|ppm|pnm|tiff?|bmp|webp|jpe?g)$/i;
const YAMLS = /\.ya?ml$/i;
const LOSSY = /\.jpe?g$/i;

/** Take files: a map first, as scans are looked for on it. Of a folder only its map is taken. */
export async function take(list, folder = "") {
  change({ trouble: "" });
  const all = [...list], yamls = [], scans = [];
  let images = all.filter((f) => IMAGES.test(f.name));
  for (const file of all.filter((f) => !IMAGES.test(f.name))) {
    // `ros2 topic echo` writes YAML as well; that of a map names its image.
    const named = YAMLS.test(file.name) && /^\s*image\s*:\s*["']?([^"'\n]*[/\\])?([^"'\n]*?)["']?\s*$/m.exec(await file.slice(0, 65536).text());
    (named ? yamls : scans).push(file);
    if (named && images.some((f) => f.name === named[2])) images = images.filter((f) => f.name === named[2]);
  }
  if (folder) scans.length = 0;
  if (folder && !images.length) change({ trouble: `${folder}: expected the image of a map in this folder.` });
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
    const [image] = images, reading = yaml ? {} : await askReading(image);
    if (!reading) return;
    if (LOSSY.test(image.name)) reading.allow_lossy = true;
    if (!(await addMap(image, yaml, reading, folder))) return;
  }
  if (scans.length) await addScans(scans[0]);
}

const FAR = 1000; // metres: a map that is longer is most likely read with a wrong resolution

/** Pixels of an image, [width, height]; null if the browser does not read it. */
async function sizeOf(file) {
  const head = /^P[25]\s(?:#.*\s)*(\d+)\s+(\d+)/.exec(await file.slice(0, 1000).text());
  if (head) return [Number(head[1]), Number(head[2])];
  const image = await createImageBitmap(file).catch(() => null);
  return image && [image.width, image.height];
}

/** Ask what an image does not say: {resolution, origin}; null if that is given up. */
async function askReading(file) {
  const dialog = $("reading"), field = $("resolution"), words = $("reading-size"), size = await sizeOf(file);
  let sure = false; // that the map is so large
  const longest = () => (size ? Math.max(...size) * Number(field.value) : 0);
  const tell = (asks) => {
    const [wide, high] = (size ?? []).map((pixels) => pixels * Number(field.value));
    words.textContent = size ? `A map of ${wide.toFixed(1)} m × ${high.toFixed(1)} m.${asks ? ` Is a pixel ${field.value} m wide? Press again to use it.` : ""}` : "";
    words.classList.toggle("warn", asks);
  };
  const changed = () => { sure = false; tell(longest() > FAR && size); };
  const use = () => {
    if (!field.reportValidity()) return;
    if (longest() > FAR && !sure) {
      sure = true;
      tell(true);
    } else {
      dialog.close("ok");
    }
  };
  $("reading-name").textContent = file.name;
  changed();
  field.addEventListener("input", changed);
  $("reading-ok").addEventListener("click", use);
  dialog.returnValue = "";
  dialog.showModal();
  await new Promise((done) => { dialog.addEventListener("close", done, { once: true }); });
  field.removeEventListener("input", changed);
  $("reading-ok").removeEventListener("click", use);
  if (dialog.returnValue !== "ok") return null;
  const origin = ["x", "y", "yaw"].map((part) => $(`origin-${part}`).value || "0").join(",");
  return { resolution: field.value, origin };
}

/** What is dropped: files, or those in a folder, with its name. */
async function dropped(transfer) {
  const entries = [...transfer.items].map((one) => one.webkitGetAsEntry?.()), files = [...transfer.files];
  if (entries.length !== 1 || !entries[0]?.isDirectory) return [files];
  const asked = (ask) => new Promise((done) => { ask(done, () => done([])); });
  const reader = entries[0].createReader(), inside = await asked((...how) => reader.readEntries(...how));
  return [await Promise.all(inside.filter((one) => one.isFile).map((one) => asked((...how) => one.file(...how)))), entries[0].name];
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
    if (event.dataTransfer.files.length) dropped(event.dataTransfer).then((all) => take(...all));
  });
}
