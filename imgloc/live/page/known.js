// What is known beforehand: a region drawn by hand, a place with a heading, room around the sensor.

import { degrees, fixed } from "./geometry.js";

export const CORNERS = 60; // of a region, at most
export const RADIUS = 1, TURN = Math.PI / 4; // of an arrow, until they are changed

/** What of it goes to the service, as the parameters of `imgloc localize`. */
export function priorOf({ near, region, clearance }) {
  return {
    near: near && near.map((value) => value.toFixed(4)).join(","),
    region: region && regionText(region),
    clearance: clearance > 0 ? clearance : null,
  };
}

/** The corners of a region in one line. */
export const regionText = (region) => region.flat().map((value) => value.toFixed(3)).join(",");

/** Whether anything is known. */
export const isKnown = ({ near, region, clearance }) => Boolean(near || region || clearance > 0);

/** The area of a polygon, m². */
export const area = (points) => Math.abs(points.reduce((sum, [x, y], k) => {
  const [nextX, nextY] = points[(k + 1) % points.length];
  return sum + x * nextY - nextX * y;
}, 0)) / 2;

/** What is known, in words. */
export function knownWords({ near, region, clearance }) {
  const said = [];
  if (near) {
    const [x, y, yaw, radius, turn] = near;
    const heading = turn < Math.PI - 1e-6 ? `, heading ${fixed(degrees(yaw), 0)} ± ${degrees(turn).toFixed(0)}°` : "";
    said.push(`Within ${radius} m of ${fixed(x, 2)}, ${fixed(y, 2)}${heading}.`);
  }
  if (region) said.push(`In a region of ${area(region).toFixed(1)} m².`);
  if (clearance > 0) said.push(`At least ${clearance} m from walls.`);
  return said.join(" ") || "Nothing: the pose may be anywhere on the map.";
}
