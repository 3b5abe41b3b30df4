//! A headless Chromium, driven over WebDriver by ChromeDriver.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

const MISSING: &str = "this test looks at pages in Chromium; install it with \
                       `apt-get install -y --no-install-recommends chromium chromium-driver`";
/// A driver that answers nothing for so long has failed.
const PATIENCE: Duration = Duration::from_secs(60);
/// What ChromeDriver prints before its port.
const STARTED: &str = "started successfully on port ";
/// Key that WebDriver gives for the name of an element.
const ELEMENT: &str = "element-6066-11e4-a52e-4f735466cecf";

/// A browser with an empty profile, ended with this value.
pub(crate) struct Browser {
    driver: Child,
    port: u16,
    session: String,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Starts driver and browser.
    pub(crate) fn start() -> Self {
        let mut command = Command::new("chromedriver");
        command.arg("--port=0").stdout(Stdio::piped()).stderr(Stdio::null());
        let mut driver = command.spawn().unwrap_or_else(|error| panic!("{MISSING} ({error})"));
        // The driver keeps its output, lest writing to it fails.
        let output = BufReader::new(driver.stdout.as_mut().expect("its output"));
        let port = output
            .lines()
            .map_while(Result::ok)
            .find_map(|line| line.split_once(STARTED)?.1.trim_end_matches('.').parse().ok())
            .expect("ChromeDriver names its port");
        let profile = tempfile::tempdir().expect("a folder for the profile");
        let mut browser = Self { driver, port, session: String::new(), _profile: profile };
        let reply = browser.post("/session", &browser.capabilities());
        let session = reply["sessionId"].as_str().unwrap_or_else(|| panic!("{MISSING} ({reply})"));
        browser.session = format!("/session/{session}");
        browser
    }

    fn capabilities(&self) -> Value {
        let profile = format!("--user-data-dir={}", self._profile.path().display());
        let arguments = [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--window-size=1280,800",
            &profile,
        ];
        json!({ "capabilities": { "alwaysMatch": {
            "browserName": "chrome",
            "goog:chromeOptions": { "args": arguments },
            "goog:loggingPrefs": { "browser": "ALL" },
        } } })
    }

    /// Opens a file.
    pub(crate) fn open(&self, file: &Path) {
        self.command("/url", &json!({ "url": format!("file://{}", file.display()) }));
    }

    /// Opens a file at an address within it, from the start even where it is shown already.
    pub(crate) fn open_at(&self, file: &Path, address: &str) {
        self.command("/url", &json!({ "url": "about:blank" }));
        self.command("/url", &json!({ "url": format!("file://{}{address}", file.display()) }));
    }

    /// Drags an element by so many pixels.
    pub(crate) fn drag(&self, selector: &str, (right, down): (i32, i32)) {
        let element = json!({ ELEMENT: self.find(selector) });
        let start = json!({ "type": "pointerMove", "origin": element, "x": 0, "y": 0 });
        let by = |x: i32, y: i32| json!({ "type": "pointerMove", "origin": "pointer", "x": x, "y": y, "duration": 50 });
        let (near, far) = (by(right / 2, down / 2), by(right - right / 2, down - down / 2));
        let [press, release] =
            ["pointerDown", "pointerUp"].map(|kind| json!({ "type": kind, "button": 0 }));
        let pointer = json!([{ "type": "pointer", "id": "mouse", "actions": [start, press, near, far, release] }]);
        self.command("/actions", &json!({ "actions": pointer }));
    }

    /// The text of the first element that matches a CSS selector, as it is shown.
    pub(crate) fn text(&self, selector: &str) -> String {
        let path = format!("{}/element/{}/text", self.session, self.find(selector));
        self.request("GET", &path, "")["value"].as_str().unwrap_or_default().to_owned()
    }

    /// Clicks the middle of an element.
    pub(crate) fn click(&self, selector: &str) {
        self.command(&format!("/element/{}/click", self.find(selector)), &json!({}));
    }

    /// Presses and releases a key; special ones have WebDriver's code points.
    pub(crate) fn press(&self, key: &str) {
        let strokes =
            json!([{ "type": "keyDown", "value": key }, { "type": "keyUp", "value": key }]);
        let keyboard = json!([{ "type": "key", "id": "keyboard", "actions": strokes }]);
        self.command("/actions", &json!({ "actions": keyboard }));
    }

    /// What a script returns.
    pub(crate) fn evaluate(&self, script: &str) -> Value {
        self.command("/execute/sync", &json!({ "script": script, "args": [] }))
    }

    /// Shows pages as a screen of this width would.
    pub(crate) fn set_width(&self, width: u32) {
        let metrics =
            json!({ "width": width, "height": 800, "deviceScaleFactor": 1, "mobile": true });
        let order = json!({ "cmd": "Emulation.setDeviceMetricsOverride", "params": metrics });
        self.command("/goog/cdp/execute", &order);
    }

    /// Errors, warnings and messages of the pages since the last time.
    pub(crate) fn console(&self) -> Vec<Value> {
        let entries = self.command("/se/log", &json!({ "type": "browser" }));
        entries.as_array().expect("a list of messages").clone()
    }

    fn find(&self, selector: &str) -> String {
        let query = json!({ "using": "css selector", "value": selector });
        let found = self.command("/element", &query);
        found[ELEMENT].as_str().expect("an element").to_owned()
    }

    fn command(&self, path: &str, body: &Value) -> Value {
        self.post(&format!("{}{path}", self.session), body)
    }

    fn post(&self, path: &str, body: &Value) -> Value {
        let mut reply = self.request("POST", path, &body.to_string());
        let value = reply["value"].take();
        assert!(value.get("error").is_none(), "{path} {body}: {value}");
        value
    }

    /// One HTTP request on a connection of its own.
    fn request(&self, method: &str, path: &str, body: &str) -> Value {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("ChromeDriver");
        stream.set_read_timeout(Some(PATIENCE)).expect("a limit");
        let length = body.len();
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\
             Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
        );
        stream.write_all(format!("{head}{body}").as_bytes()).expect("a request");
        let content = read_content(BufReader::new(stream));
        serde_json::from_slice(&content).expect("replies are JSON")
    }
}

/// The content of an HTTP reply. The driver may keep the connection open, so its length counts.
fn read_content(mut reply: impl BufRead) -> Vec<u8> {
    let mut length = 0;
    let mut line = String::new();
    while reply.read_line(&mut line).expect("a reply in time") > 2 {
        if let Some((name, value)) = line.split_once(':')
            && name.eq_ignore_ascii_case("content-length")
        {
            length = value.trim().parse().expect("a length");
        }
        line.clear();
    }
    let mut content = vec![0; length];
    reply.read_exact(&mut content).expect("as much as announced");
    content
}

impl Drop for Browser {
    /// Ends the browser, then the driver: also where a test fails, and where the browser answers no more.
    fn drop(&mut self) {
        let end = || self.request("DELETE", &self.session, "");
        let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(end));
        drop(ended);
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}
