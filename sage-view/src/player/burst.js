// Drawing that the pages share.

function burst(c, x, y, radius) {
  c.beginPath();
  for (let k = 0; k < 16; k++) {
    const r = k % 2 ? 0.45 * radius : radius, a = (k * Math.PI) / 8;
    c.lineTo(x + r * Math.cos(a), y + r * Math.sin(a));
  }
  c.closePath();
  c.fillStyle = "#f0e442";
  c.strokeStyle = "#222";
  c.lineWidth = 0.12 * radius;
  c.fill();
  c.stroke();
}
