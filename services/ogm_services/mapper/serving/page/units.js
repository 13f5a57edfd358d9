// Figures as texts.

export const percent = (share) => share === null ? "none" : `${(100 * share).toFixed(1)} %`;
// To a tenth; what is small keeps two digits.
const short = (value) => value > 0 && value < 1 ? String(Number(value.toPrecision(2))) : value.toFixed(1);
export const area = (value) => `${short(value)} m²`;
export const whole = (count) => count.toLocaleString("en");
export const counted = (count, thing) => `${whole(count)} ${thing}${count === 1 ? "" : "s"}`;
export const perSecond = (rate, what = "") => `${rate.toFixed(rate < 10 ? 1 : 0)} ${what}/s`;
export const metresBy = (width, height) => `${short(width)} × ${short(height)} m`;
export const bits = (value) => `${value.toFixed(3)} bits`;

// The time of day.
export const clock = (ms) => new Date(ms).toLocaleTimeString([], {hourCycle: "h23"});

export function duration(seconds) {
  const units = [[86400, "d"], [3600, "h"], [60, "min"]].find(([length]) => seconds >= 2 * length) ?? [1, "s"];
  return `${(seconds / units[0]).toFixed(units[0] > 1 ? 1 : 0)} ${units[1]}`;
}

// The largest of 1, 2, 5, 10, ... metres that is at most `most`.
export function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].find((digit) => digit * power <= most) * power;
}

export const metres = (length) => length >= 1000 ? `${length / 1000} km` : `${Number(length.toPrecision(1))} m`;
