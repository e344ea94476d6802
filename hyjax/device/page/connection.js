// Connection to the server of a tour: questions with their answers, and pictures as they come.
// Its events: "open"; "lost", after each try that the server refuses, too; "picture" and "news".

const AGAIN = 1000; // milliseconds until the next try after the connection was lost

export class Connection extends EventTarget {
  constructor(address) {
    super();
    this.address = address;
    this.number = 0;
    this.waiting = new Map(); // by number
    this.open();
  }

  /** Resolves when the connection is open; after it was lost, when it is open again. */
  get opened() {
    if (this.ready) return Promise.resolve();
    return new Promise((resolve) => { this.addEventListener("open", resolve, { once: true }); });
  }

  open() {
    this.socket = new WebSocket(this.address);
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("open", () => {
      this.ready = true;
      this.dispatchEvent(new Event("open"));
    });
    this.socket.addEventListener("message", ({ data }) => this.take(data));
    this.socket.addEventListener("close", () => {
      this.ready = false;
      this.dispatchEvent(new Event("lost"));
      for (const { reject } of this.waiting.values()) reject(new Error("The connection to the server was lost."));
      this.waiting.clear();
      setTimeout(() => this.open(), AGAIN);
    });
  }

  /** Send a message of a task; its number. */
  send(task, content) {
    this.number += 1;
    if (this.ready) this.socket.send(JSON.stringify({ task, number: this.number, ...content }));
    return this.number;
  }

  /** Answer to a task: its head, with the binary content if there is any. */
  ask(task, content) {
    if (!this.ready) return Promise.reject(new Error("There is no connection to the server."));
    const number = this.send(task, content);
    return new Promise((resolve, reject) => this.waiting.set(number, { resolve, reject }));
  }

  take(data) {
    let head;
    let content = null;
    if (typeof data === "string") {
      head = JSON.parse(data);
    } else {
      const bytes = new Uint8Array(data);
      const end = bytes.indexOf(10);
      head = JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)));
      content = data.slice(end + 1);
    }
    if ("picture" in head) {
      this.dispatchEvent(new CustomEvent("picture", { detail: { head, content } }));
      return;
    }
    const waiting = this.waiting.get(head.number);
    this.waiting.delete(head.number);
    if (!waiting) {
      this.dispatchEvent(new CustomEvent("news", { detail: head }));
    } else if ("refused" in head) {
      waiting.reject(new Error(head.refused));
    } else {
      waiting.resolve({ ...head, content });
    }
  }
}
