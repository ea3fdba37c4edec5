use sage_data::{Recording, womd::Shard};
use std::time::Instant;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let path = std::path::Path::new(&args[1]);
    let mut records = Vec::new();
    let t = Instant::now();
    let mut shard = Shard::open(path).unwrap();
    while let Some(record) = shard.next_record() {
        records.push(record.unwrap());
    }
    println!("framing {:?} {} records", t.elapsed(), records.len());
    for _ in 0..5 {
        let t = Instant::now();
        for r in &records {
            if let Err(e) = r.read(path) {
                println!("{}", e);
            }
        }
        println!("records {:?}", t.elapsed() / records.len() as u32);
        if args.len() > 2 {
            let files: Vec<Vec<u8>> = args[2..].iter().map(|f| std::fs::read(f).unwrap()).collect();
            let t = Instant::now();
            for (k, f) in files.into_iter().enumerate() {
                Recording::from_bytes(args[2 + k].as_ref(), f).unwrap();
            }
            println!("pickles {:?}", t.elapsed() / (args.len() - 2) as u32);
        }
    }
}
