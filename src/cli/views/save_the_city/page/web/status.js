const STATUS = ["open", "complete", "burned down"];

