"use strict";
// An artificial horizon: the main attitude, and that of a second source as a dashed line.

const SKY = ["#3b82c4", "#2b5f92"], GROUND = ["#8a6238", "#6b4a29"]; // light, dark
const dark = matchMedia("(prefers-color-scheme: dark)");

function drawHorizon(canvas, main, second) {
  const [ctx, width, height] = fitCanvas(canvas);
  ctx.clearRect(0, 0, width, height);
  if (!main) return;
  const scale = height / 60 * DEGREES; // sixty degrees from top to bottom
  const radius = Math.min(width, height) / 2 - 8;
  const tilted = ([roll, pitch], act) => {
    ctx.save();
    ctx.translate(width / 2, height / 2);
    ctx.rotate(-roll);
    ctx.translate(0, pitch * scale);
    act();
    ctx.restore();
  };
  ctx.save();
  ctx.beginPath();
  ctx.rect(0, 0, width, height);
  ctx.clip();
  tilted(main, () => drawWorld(ctx, width, scale, height));
  if (second) {
    tilted(second, () => {
      ctx.strokeStyle = "#ffd24a";
      ctx.lineWidth = 2;
      ctx.setLineDash([7, 5]);
      stroke(ctx, [[-width, 0], [width, 0]]);
    });
  }
  drawFrame(ctx, width, height, radius, main);
  ctx.restore();
}

function stroke(ctx, points) {
  ctx.beginPath();
  points.forEach(([x, y], number) => number ? ctx.lineTo(x, y) : ctx.moveTo(x, y));
  ctx.stroke();
}

function drawWorld(ctx, width, scale, height) {
  const far = 3 * (width + height), shade = dark.matches ? 1 : 0;
  ctx.fillStyle = SKY[shade];
  ctx.fillRect(-far, -far, 2 * far, far);
  ctx.fillStyle = GROUND[shade];
  ctx.fillRect(-far, 0, 2 * far, far);
  ctx.strokeStyle = ctx.fillStyle = "#fff";
  ctx.lineWidth = 2;
  stroke(ctx, [[-far, 0], [far, 0]]);
  ctx.lineWidth = 1;
  ctx.font = "11px system-ui, sans-serif";
  ctx.textBaseline = "middle";
  for (let degrees = -80; degrees <= 80; degrees += 5) {
    if (!degrees) continue;
    const y = -degrees / DEGREES * scale, half = degrees % 10 ? 12 : 28;
    stroke(ctx, [[-half, y], [half, y]]);
    if (degrees % 10 === 0) ctx.fillText(Math.abs(degrees), half + 5, y);
  }
}

// The fixed parts: roll scale, aircraft symbol, and heading.
function drawFrame(ctx, width, height, radius, [roll, , yaw]) {
  ctx.save();
  ctx.translate(width / 2, height / 2);
  ctx.strokeStyle = ctx.fillStyle = "#fff";
  ctx.lineWidth = 1.5;
  for (const degrees of [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60]) {
    const angle = (degrees - 90) / DEGREES, inner = degrees % 30 ? radius - 6 : radius - 10;
    stroke(ctx, [[Math.cos(angle) * radius, Math.sin(angle) * radius], [Math.cos(angle) * inner, Math.sin(angle) * inner]]);
  }
  ctx.save();
  ctx.rotate(-roll);
  ctx.beginPath();
  ctx.moveTo(0, -radius + 11);
  ctx.lineTo(-6, -radius + 21);
  ctx.lineTo(6, -radius + 21);
  ctx.fill();
  ctx.restore();
  ctx.strokeStyle = "#ffb02e";
  ctx.lineWidth = 3.5;
  stroke(ctx, [[-46, 0], [-16, 0], [-16, 7]]);
  stroke(ctx, [[46, 0], [16, 0], [16, 7]]);
  stroke(ctx, [[-2, 0], [2, 0]]);
  ctx.restore();
  const heading = ((yaw * DEGREES % 360) + 360) % 360;
  const text = `heading ${heading.toFixed(0).padStart(3, "0")}°`;
  ctx.font = "600 12px system-ui, sans-serif";
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  ctx.fillStyle = "rgba(0,0,0,.45)";
  ctx.fillRect(width / 2 - 48, height - 22, 96, 18);
  ctx.fillStyle = "#fff";
  ctx.fillText(text, width / 2, height - 9);
  ctx.textAlign = "start";
}
