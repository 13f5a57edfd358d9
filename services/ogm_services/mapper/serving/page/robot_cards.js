// The robots of the panel, a card each: where it is, when it was heard, and what keeps its scans out of the map.
import {button, make, say} from "./elements.js";
import {inkOf} from "./overlay.js";
import {isSilent, present} from "./robots.js";
import {change, state} from "./state.js";
import {element} from "./tables.js";
import {missed, rateOf, troublesOf} from "./troubles.js";
import {counted, duration, perSecond, whole} from "./units.js";

const cards = new Map();  // by name; a card stays while its robot does, and so does the focus in it

class Card {
  constructor(name) {
    this.name = name;
    this.heard = make("span", {className: "heard"});
    this.pose = make("span");
    this.scans = make("span");
    this.key = make("span", {className: "key"});
    this.follow = button(this.key, () => change("followed", state.followed === name ? null : name), {className: "robot"});
    this.follow.append(make("span", {className: "name"}, name));
    this.summary = make("summary");
    this.reasons = make("dl");
    this.troubles = make("details", {hidden: true}, this.summary, this.reasons);
    this.element = make("li", {}, make("div", {className: "line"}, this.follow, this.heard),
      make("div", {className: "line more"}, this.pose, this.scans), this.troubles);
  }

  show({pose, alive, age_s, sources}, troubles) {
    const silent = isSilent({alive, age_s}), rate = rateOf(this.name), followed = state.followed === this.name;
    const integrated = Object.values(sources).reduce((sum, source) => sum + source.integrated, 0);
    this.element.classList.toggle("silent", silent);
    this.key.style.background = inkOf(this.name);
    this.follow.title = followed ? "stop following" : "follow";
    this.follow.setAttribute("aria-pressed", String(followed));
    say(this.heard, age_s === null ? "never heard" : silent ? `silent ${duration(age_s)}` : followed ? "followed" : "alive");
    say(this.pose, pose ? `${pose[0].toFixed(1)}, ${pose[1].toFixed(1)} m` : "no pose");
    say(this.scans, `${counted(integrated, "scan")}${rate === null || silent ? "" : `, ${perSecond(rate)}`}`);
    this.troubles.hidden = !troubles.length;
    this.troubles.classList.toggle("now", troubles.some(({rate, count}) => count === null || rate > 0));
    say(this.summary, inShort(troubles));
    this.reasons.replaceChildren(...troubles.flatMap(({sensor, what, count, rate, help}) => [
      make("dt", {}, make("span", {}, `${sensor}: ${what}`),
        make("span", {}, `${count === null ? "" : whole(count)}${rate > 0 ? `, ${perSecond(rate)}` : ""}`)),
      make("dd", {}, help)]));
  }
}

function inShort(troubles) {
  const names = [...new Set(troubles.map(({what}) => what))].join(", "), count = missed(troubles);
  return count ? `${whole(count)} not in the map: ${names}` : names;
}

export function showRobots() {
  const list = element("robots"), names = present().filter((name) => state.status?.robots[name]);
  for (const [name, card] of cards) {
    if (names.includes(name)) continue;
    card.element.remove();
    cards.delete(name);
  }
  names.forEach((name, k) => {
    if (!cards.has(name)) {
      cards.set(name, new Card(name));
      list.insertBefore(cards.get(name).element, list.children[k] ?? null);
    }
    cards.get(name).show(state.status.robots[name], troublesOf(name));
  });
  say(element("count"), names.length ? whole(names.length) : "none yet");
}
