// Those who wait for a picture: for any of what has changed, or for one at rest, with all shadows cast in full.

export class Waiting {
  constructor() {
    this.entries = [];
  }

  /** Resolves with `resolve`; see above. */
  promise(rest) {
    return new Promise((resolve, reject) => this.entries.push({ resolve, reject, rest }));
  }

  /** Those who have waited long enough, who wait no longer. */
  take(resting) {
    const due = this.entries.filter(({ rest }) => resting || !rest);
    this.entries = this.entries.filter((entry) => !due.includes(entry));
    return due;
  }
}
