// Wipe of two stills; in its place the exported page, where it was made and this browser has WebGPU.
const wipe = document.querySelector(".wipe");
wipe.querySelector("input").addEventListener("input", ({ target }) => wipe.style.setProperty("--photo", `${target.value}%`));

const exported = document.getElementById("exported");
const gpu = location.protocol !== "file:" && navigator.gpu; // a page from the disk cannot run
if (exported && gpu) {
  gpu.requestAdapter().then((adapter) => {
    if (!adapter) return;
    document.getElementById("stills").textContent =
      "The built-in room, relit by your own GPU. Drag the wipe or a lamp, set the sun's hour, fly off into the scan, and change the preset.";
    wipe.replaceWith(exported.content);
  });
}
