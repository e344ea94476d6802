// Page that times schedules: jobs from `hyjax tune --device`, or those of bench.json, whose times are saved.

import { Engine, openDevice } from "./engine.js";
import { timeJob } from "./timing.js";

const FORMAT = 1;
const RETRY = 2000; // milliseconds
const SIGN_OF_LIFE = 10000; // milliseconds
const PRESETS = ["hyjax", "paper-50", "paper-80", "naive-50"];
const at = (id) => document.getElementById(id);
const pause = (ms) => new Promise((done) => setTimeout(done, ms));

function say(text) {
  at("status").textContent = text;
}

function complain(text) {
  at("trouble").textContent = text ?? "";
  at("trouble").hidden = !text;
}

/** What this device is called, as far as the browser tells. */
async function describe(device) {
  const hints = await navigator.userAgentData?.getHighEntropyValues(["model", "platform"]).catch(() => null);
  const adapter = device.hyjaxName ?? "unknown adapter";
  const system = hints?.platform || navigator.platform || "device";
  return {
    name: (hints?.model || `${system} with ${adapter}`).slice(0, 100),
    adapter: adapter.slice(0, 300),
    agent: navigator.userAgent.slice(0, 300),
    timer: device.features.has("timestamp-query") ? "gpu" : "wall",
  };
}

/** Ask the server; an answer that is none ends in an Error with its one line. */
async function send(path, content) {
  const body = JSON.stringify(content);
  const response = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body });
  if (!response.ok) throw new Error(await response.text());
  return response.json();
}

/** Repeat what fails because the server cannot be reached. */
async function untilReached(call) {
  for (;;) {
    try {
      const result = await call();
      complain();
      return result;
    } catch (error) {
      if (!(error instanceof TypeError)) throw error; // fetch's, of the network
      complain("hyjax does not answer. It goes on as soon as it does.");
      await pause(RETRY);
    }
  }
}

async function live(device, identity) {
  await untilReached(() => send("hello", identity));
  setInterval(() => send("alive", {}).catch(() => null), SIGN_OF_LIFE);
  for (;;) {
    say("Ready. Waiting for the next schedules …");
    const response = await untilReached(() => fetch("job"));
    if (response.status === 204) continue;
    if (response.status === 410) return say("Done: hyjax has all it needs. This page can be closed.");
    if (response.status === 409) { // hyjax was started anew
      await untilReached(() => send("hello", identity));
      continue;
    }
    if (!response.ok) throw new Error(await response.text());
    const job = await response.json();
    const report = (round) => untilReached(() => send("round", { job: job.job, ...round }));
    await runJob(device, job, report);
  }
}

const compiled = {}; // pipelines of all jobs

/** Time a job; `report` takes each round and says whether there are more. */
async function runJob(device, job, report) {
  const { request, program } = job;
  say(`Compiling the shaders of ${request.schedules.length} schedules …`);
  const engine = await Engine.create(device, program, request.workload.lights, {}, compiled);
  at("progress").hidden = false;
  try {
    await timeJob(engine, request, job.done ?? 0, async (round) => {
      const answer = await report(round);
      const share = (round.round + 1) / request.rounds;
      at("progress").value = share;
      say(`Round ${round.round + 1} of ${request.rounds}: ${request.schedules.length} schedules in turns`);
      return answer.more;
    }, say);
  } finally {
    engine.destroy();
    at("progress").hidden = true;
  }
}

/** Median and 95th percentile, with positions between samples as NumPy has them. */
function percentile(values, share) {
  const sorted = [...values].sort((a, b) => a - b);
  const place = share * (sorted.length - 1);
  const low = Math.floor(place);
  return sorted[low] + (place - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
}

function show(request, rounds) {
  const body = at("times").tBodies[0];
  body.replaceChildren(...request.schedules.map((schedule, k) => {
    const samples = rounds.map((round) => round.milliseconds[k]);
    const row = document.createElement("tr");
    const steps = Object.entries(schedule.steps).sort((a, b) => b[0] - a[0]).map(([f, n]) => `${f}:${n}`).join(" ");
    const cells = [schedule.name ?? "", steps, percentile(samples, 0.5).toFixed(2), percentile(samples, 0.95).toFixed(2)];
    cells.forEach((text, column) => {
      const cell = row.insertCell();
      cell.textContent = text;
      if (column > 1) cell.className = "n";
    });
    return row;
  }));
  at("times").hidden = false;
}

/** The latency file of rounds, see docs/latency_format.md. */
function latencyFile(identity, request, rounds) {
  const measured = request.schedules.map(({ whole, ...form }, k) => ({
    ...form,
    milliseconds: rounds.map((round) => round.milliseconds[k]),
  }));
  return {
    format: FORMAT,
    device: { ...identity, name: at("name").value.trim() || identity.name },
    workload: request.workload,
    measured,
    warm_up: rounds[0].warm_up,
    rounds: rounds.map((round) => round.at),
    created: new Date().toISOString(),
  };
}

function save(content) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(content, null, 1)], { type: "application/json" }));
  link.download = "latency.json";
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** Schedules of a job whose names are among these, with their stages of the program. */
function choose(job, names) {
  const kept = job.request.schedules.map((schedule, k) => [schedule, k]).filter(([s]) => names.includes(s.name));
  const stages = Object.fromEntries(kept.map(([, k], place) => [`${k}`, `${place}`]));
  const launches = job.program.launches.filter((l) => l.stage in stages).map((l) => ({ ...l, stage: stages[l.stage] }));
  const shaders = Object.fromEntries(launches.map((l) => [l.shader, job.program.shaders[l.shader]]));
  return {
    ...job,
    request: { ...job.request, schedules: kept.map(([schedule]) => schedule) },
    program: { ...job.program, launches, shaders },
  };
}

function bench(device, identity, job) {
  const { width, height, lights } = job.request.workload;
  at("name").value = identity.name;
  at("choice").hidden = false;
  say(`Ready to time ${width} x ${height} pixels with ${lights} lights.`);
  const buttons = [at("presets"), at("all"), at("save")];
  async function time(chosen) {
    const rounds = [];
    buttons.forEach((button) => { button.disabled = true; });
    const start = performance.now();
    try {
      await runJob(device, chosen, async (round) => {
        rounds.push({ ...round, at: (performance.now() - start) / 1000 });
        return { more: !round.last && rounds.length < chosen.request.rounds };
      });
      show(chosen.request, rounds);
      say(`Done: ${rounds.length} rounds.`);
      at("save").hidden = false;
      at("save").onclick = () => save(latencyFile(identity, chosen.request, rounds));
    } catch (error) {
      complain(error.message);
    }
    buttons.forEach((button) => { button.disabled = false; });
  }
  at("presets").onclick = () => time(choose(job, PRESETS));
  at("all").onclick = () => time(job);
}

async function keepAwake() {
  const ask = () => document.visibilityState === "visible" && navigator.wakeLock?.request("screen").catch(() => null);
  document.addEventListener("visibilitychange", ask);
  await ask();
}

async function main() {
  let stored = null;
  try {
    const device = await openDevice();
    const identity = await describe(device);
    device.lost.then(({ message }) => complain(`The graphics processor was lost (${message}). Open the page anew.`));
    at("facts").textContent = `${identity.adapter}; times by the ${identity.timer === "gpu" ? "graphics processor's" : "browser's"} clock`;
    await keepAwake();
    stored = await fetch("bench.json");
    if (stored.status === 200) bench(device, identity, await stored.json());
    else await live(device, identity);
  } catch (error) {
    say("Stopped.");
    complain(`${error.message}\nOpen the page anew to try once more.`);
    if (stored?.status !== 200) await send("trouble", { error: `${error.message}`.slice(0, 1000) }).catch(() => null);
  }
}

main();
