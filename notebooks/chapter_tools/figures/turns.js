// A scene that is turned about the vertical, and how far forecasts are off in it.
function turned([x, y, z], degrees, [u, v]) { // about the vertical through (u, v)
  const angle = (degrees * Math.PI) / 180, c = Math.cos(angle), s = Math.sin(angle);
  return [u + c * (x - u) - s * (y - v), v + s * (x - u) + c * (y - v), z];
}
function errorsOf(forecast, truth, degrees, centre) { // at each frame, for a forecast in the turned scene
  return truth.map((place, t) => Math.hypot(...turned(place, degrees, centre).map((v, k) => v - forecast[t][k])));
}
const meanOf = (values) => values.reduce((sum, v) => sum + v, 0) / values.length;
