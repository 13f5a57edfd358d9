// What happens a second: counts of the status, compared with those of some seconds before.
const SPAN_S = 5;  // of the counts that are compared
const KEPT = 16;  // looks

export class Rates {
  #whose = null;
  #looks = [];  // [{time, counts}], oldest first

  // Take the counts of one more status, flat by name, at a time in s; `whose` names the processes that have counted.
  look(whose, time, counts) {
    if (whose !== this.#whose) this.#looks = [];  // others, which count from 0
    this.#whose = whose;
    this.#looks.push({time, counts});
    while (this.#looks.length > 2 && (time - this.#looks[1].time >= SPAN_S || this.#looks.length > KEPT)) {
      this.#looks.shift();
    }
  }

  // How many a second; null until it is known.
  of(name) {
    const first = this.#looks[0], last = this.#looks.at(-1);
    if (!first || last.time <= first.time) return null;
    return ((last.counts[name] ?? 0) - (first.counts[name] ?? 0)) / (last.time - first.time);
  }
}
