function mean(numbers) {
  return numbers.reduce((sum, number) => sum + number, 0) / numbers.length;
}

/** Two decimals, with a real minus sign. */
function fixed(number) {
  return number.toFixed(2).replace("-", "−").replace("−0.00", "0.00");
}

/** "+0.25", "−1.20", "0". */
function signed(number) {
  const text = fixed(number);
  if (text === "0.00") {
    return "0";
  }
  return number > 0 ? `+${text}` : text;
}

function percent(share) {
  return `${Math.round(share * 100)}`;
}
