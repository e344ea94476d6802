// Presets of an exported page: configurations that its frames are relit by, one after the other.
const KEYS = ["programs", "resolutions", "exponent"];

/** Let the visitor choose among the page's own configuration and its presets, if it has any. */
export function connectPresets(viewer) {
  const { page } = viewer;
  const own = Object.fromEntries(KEYS.map((key) => [key, page[key]]));
  const presets = { [page.configuration]: own, ...page.presets };
  const select = document.getElementById("preset");
  document.getElementById("preset-row").hidden = Object.keys(presets).length < 2;
  select.append(...Object.keys(presets).map((name) => new Option(name)));
  select.addEventListener("change", async () => {
    select.disabled = true;
    document.body.dataset.state = "loading"; // "Preparing the picture …"
    Object.assign(page, presets[select.value]);
    const { device } = viewer;
    Object.assign(viewer, { stopped: true, device: null }); // its end is no loss that `Viewer.lost` mends
    device?.destroy(); // there is none where the start failed
    await viewer.start().then(
      () => { document.body.dataset.state = "ready"; },
      (error) => viewer.fail(error),
    );
    select.disabled = false;
  });
}
