//! Hear of every violation of a campaign, past and future, from `schemas/` alone: one line of JSON each, in order,
//! none left out, none twice. `saflite-subscriber ENDPOINT CAMPAIGN [KEYS]`, KEYS being a folder of `saflite keys add`.
//!
//! Facts come on `event-json/*` while one listens; what was missed is asked for on `control/events`, in JSON, too.

use serde_json::{json, Value};
use std::collections::BTreeMap;
use std::{env, error::Error, path::Path, time::Duration};
use zenoh::{Config, Session, Wait};

const ROOT: &str = "saflite/2";
const NAME: &str = "rust";
const QUIET: Duration = Duration::from_secs(1); // after so long without a fact the farm is asked for missed ones

type Fallible<T> = Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Fallible<()> {
    let args: Vec<String> = env::args().collect();
    let [_, endpoint, campaign, keys @ ..] = args.as_slice() else {
        return Err("usage: saflite-subscriber ENDPOINT CAMPAIGN [KEYS]".into());
    };
    let session = zenoh::open(config(endpoint, keys.first())?).wait()?;
    let by = keys.first().map(|folder| format!("by/{}/", name_of(folder))).unwrap_or_default();
    let facts = session.declare_subscriber(format!("{ROOT}/{campaign}/event-json/*")).wait()?;
    let mut waiting: BTreeMap<u64, Value> = BTreeMap::new();
    let mut wanted = 1;
    loop {
        if !waiting.contains_key(&wanted) {
            for event in past(&session, &by, campaign, wanted)? {
                waiting.insert(event["seq"].as_u64().unwrap_or(0), event);
            }
        }
        while let Some(event) = waiting.remove(&wanted) {
            wanted += 1;
            if event["fact"]["type"] == "violation" {
                println!("{event}");
            }
            if event["fact"]["state"] == "ended" {
                return Ok(());
            }
        }
        while let Ok(Some(sample)) = facts.recv_timeout(QUIET) {
            let event: Value = serde_json::from_slice(&sample.payload().to_bytes())?;
            let seq = event["seq"].as_u64().unwrap_or(0);
            if seq >= wanted {
                waiting.insert(seq, event);
                break;
            }
        }
    }
}

fn config(endpoint: &str, keys: Option<&String>) -> Fallible<Config> {
    let mut config = Config::default();
    config.insert_json5("mode", "\"client\"")?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    config.insert_json5("connect/timeout_ms", "60000")?;
    config.insert_json5("connect/endpoints", &json!([endpoint]).to_string())?;
    if let Some(folder) = keys {
        let file = |name: &str| format!("{folder}/{name}");
        let tls = json!({
            "root_ca_certificate": file("ca.pem"), "enable_mtls": true,
            "connect_private_key": file("key.pem"), "connect_certificate": file("cert.pem"),
        });
        config.insert_json5("transport/link/tls", &tls.to_string())?;
    }
    Ok(config)
}

fn name_of(folder: &str) -> String {
    Path::new(folder).file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Return up to 1,000 events from a sequence number on; none while the farm is away.
fn past(session: &Session, by: &str, campaign: &str, from: u64) -> Fallible<Vec<Value>> {
    let key = format!("{ROOT}/{campaign}/control/events");
    let question = json!({"verb": "events", "number": from}).to_string();
    let seal = seal(&key, question.as_bytes());
    let replies = session.get(format!("{by}{key}")).payload(question).attachment(seal).wait()?;
    while let Ok(reply) = replies.recv() {
        if let Ok(sample) = reply.result() {
            let mut answer: Value = serde_json::from_slice(&sample.payload().to_bytes())?;
            if let Value::Array(events) = answer["events"].take() {
                return Ok(events);
            }
        }
    }
    Ok(Vec::new())
}

/// The seal of a message: CRC-32 of key, a zero byte, sender and payload in hexadecimal, then the sender.
fn seal(key: &str, payload: &[u8]) -> Vec<u8> {
    let mut sum = crc32fast::Hasher::new();
    for part in [key.as_bytes(), b"\0", NAME.as_bytes(), payload] {
        sum.update(part);
    }
    format!("{:08x}{NAME}", sum.finalize()).into_bytes()
}
