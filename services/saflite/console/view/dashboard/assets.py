"""Style and script of the dashboard, on top of the report's. No build step, nothing from elsewhere."""

from __future__ import annotations

from saflite.console.view.report.script import TABLES
from saflite.console.view.report.style import CSS

STYLE = (
    CSS
    + """
[hidden]{display:none!important}
header.bar{position:sticky;top:0;z-index:2;background:var(--bg);border-bottom:1px solid var(--line);padding:8px 20px;
display:flex;flex-wrap:wrap;gap:8px 14px;align-items:center}
header.bar h1{font-size:18px;margin:0}header.bar .grow{flex:1}
.state{border-radius:20px;padding:1px 11px;border:1px solid var(--line);font-size:13px}
.state[data-state=running]{color:var(--green)}.state[data-state=paused]{color:var(--amber)}
.state[data-state=unreachable],.state[data-state=lost]{color:var(--red)}
button,input,select{font:inherit;color:inherit;background:var(--panel);border:1px solid var(--line);border-radius:8px;
padding:6px 12px;min-height:36px}
button{cursor:pointer}button:hover{border-color:var(--blue)}input[type=number]{width:110px}
nav{display:flex;gap:6px;flex-wrap:wrap;margin:4px 0 0}
nav a{padding:4px 12px;border:1px solid var(--line);border-radius:20px;font-size:13px}
.orders{display:flex;flex-wrap:wrap;gap:8px;align-items:center;margin:12px 0}
.orders form{display:flex;gap:6px}
#said{min-height:22px}
tr.find{cursor:pointer}tr.find:hover,tr.find.here{background:var(--grid)}
dialog{width:min(1180px,100%);max-width:100%;max-height:96vh;border:1px solid var(--line);border-radius:14px;
background:var(--bg);color:var(--ink);padding:14px 18px}
dialog::backdrop{background:rgba(0,0,0,.5)}
.inputs{margin:6px 0 0;padding-left:18px;font-size:13px;max-height:180px;overflow:auto}
.bar-share{display:inline-block;width:70px;height:8px;background:var(--grid);border-radius:4px;overflow:hidden}
.bar-share i{display:block;height:100%;background:var(--blue)}
[data-part]:empty::before{content:"\\2026";color:var(--muted)}
kbd{font:12px ui-monospace,monospace;border:1px solid var(--line);border-radius:4px;padding:0 5px}
td.mark,th:has(.build){text-align:center}.dot-confirmed{color:var(--red)}.dot-flaky{color:var(--amber)}.dot-other{color:var(--muted)}
@media(max-width:640px){header.bar{padding:8px 10px;position:static}dialog{padding:8px}.tiles{gap:8px}
.tile b{font-size:21px}}
"""
)

SCRIPT = (
    TABLES
    + """
const body=document.body,here=body.dataset.run,may=body.dataset.role==='operator';
const $=(query)=>document.querySelector(query);
function look(){const now=localStorage.getItem('look');if(now)document.documentElement.dataset.look=now}
function turn(){const dark=getComputedStyle(document.documentElement).getPropertyValue('--bg').trim()==='#12161d';
localStorage.setItem('look',dark?'light':'dark');look()}
look();
function say(text){const place=$('#said');if(place)place.textContent=text}
async function order(verb,text='',number=0){if(!may||!here)return;say(verb+' \\u2026');
try{const answer=await fetch('order',{method:'POST',headers:{'Content-Type':'application/json','X-Saflite':'1'},
body:JSON.stringify({verb,text,number})});const told=await answer.json();
say(told.accepted?verb+': done':verb+': '+told.message)}catch(fault){say(verb+': '+fault)}}
function set(name,text){for(const place of document.querySelectorAll('[data-figure="'+name+'"]'))
if(place.textContent!==text)place.textContent=text}
function span(s){return s<120?s.toFixed(0)+' s':s<7200?(s/60).toFixed(1)+' min':(s/3600).toFixed(1)+' h'}
function cell(row,text){const place=document.createElement('td');place.textContent=text;row.append(place);return place}
function workers(found){const table=$('#workers tbody');if(!table)return;table.replaceChildren(...found.map(one=>{
const row=document.createElement('tr');cell(row,one.worker);cell(row,one.stage);cell(row,one.state);cell(row,one.done);
const share=cell(row,''),bar=document.createElement('span'),full=document.createElement('i');bar.className='bar-share';
full.style.width=(100*one.busy_share).toFixed(0)+'%';bar.append(full);share.append(bar);
cell(row,one.silent_s.toFixed(1)+' s');cell(row,one.resident_mib.toFixed(0)+' MiB');cell(row,one.host);
cell(row,one.build.slice(0,12));return row}));$('#workers').hidden=!found.length}
let shown=-1,at=0,paused=false,lived=false;
function figures(now){paused=now.state==='paused';const state=$('.state');state.textContent=now.state;
state.dataset.state=now.state;set('behaviours',String(now.behaviours));set('finds',String(now.finds));
set('flaky',String(now.flaky));set('flights',now.flights+' of '+now.budget);set('reflown',String(now.reflown));
set('elapsed',span(now.elapsed_s));const live=now.status;for(const place of document.querySelectorAll('[data-live]'))
place.hidden=!live;if(live){set('rate',live.flights_per_s.toFixed(2)+'/s');
set('speed',live.real_time_factor.toFixed(0)+'\\u00d7');set('scorer',live.scorer+(live.scorer_pending?
' \\u2192 '+live.scorer_pending:''));set('trouble',live.trouble||'');
const beside=live.reflown+(live.checked||0)+(live.shrink_flights||0);set('eta',live.flights_per_s>0?
span(Math.max(0,now.budget-now.flights)*(1+beside/Math.max(1,now.flights))/live.flights_per_s):'\\u2013');
set('queues',Object.entries(live.queues).filter(one=>one[1]).map(one=>one.join(' ')+
(live.workers.some(worker=>worker.stage===one[0])?'':' (no worker for it)')).join(', ')||'none');
const pause=$('#pause');if(pause)pause.textContent=paused?'resume':'pause'}
workers(live?live.workers:[]);const ended=lived&&!live;lived=!!live;
if(now.version!==shown||ended){shown=now.version;const time=Date.now();if(time-at>4000||!live){at=time;refresh()}}}
function field_of(table){const field=table.closest('.scroll').previousElementSibling;
return field&&field.className==='filter'?field:null}
function fill(place,html){const were=[...place.querySelectorAll('table.sorts')].map(table=>{
const field=field_of(table),head=table.querySelector('[aria-sort]');return{words:field?field.value:'',
typing:field!==null&&field===document.activeElement,at:head?head.cellIndex:-1,
turns:head&&head.getAttribute('aria-sort')==='descending'?2:1}});
place.innerHTML=html;equip(place);rows();
[...place.querySelectorAll('table.sorts')].forEach((table,number)=>{const was=were[number];if(!was)return;
if(was.at>=0)for(let turn=0;turn<was.turns;turn++)sort(table.tHead.rows[0].cells[was.at]);
const field=field_of(table);if(!field)return;field.value=was.words;field.oninput();if(was.typing)field.focus()})}
async function load(place){const answer=await fetch('part/'+place.dataset.part);if(answer.ok){
fill(place,await answer.text());place.dataset.loaded='1'}}
const seen=new IntersectionObserver(all=>{for(const one of all){one.target.dataset.seen=one.isIntersecting?'1':'';
if(one.isIntersecting&&!one.target.dataset.loaded)load(one.target)}},{rootMargin:'200px'});
for(const place of document.querySelectorAll('[data-part]'))seen.observe(place);
function refresh(){for(const place of document.querySelectorAll('[data-part]'))
if(place.dataset.seen&&place.dataset.loaded)load(place);else delete place.dataset.loaded}
let chosen=-1;
function list(){return [...document.querySelectorAll('tr.find')].filter(row=>!row.hidden)}
function choose(to){const all=list();if(!all.length)return;chosen=Math.max(0,Math.min(all.length-1,to));
all.forEach((row,place)=>row.classList.toggle('here',place===chosen));all[chosen].scrollIntoView({block:'nearest'});
all[chosen].focus()}
function told(html){const place=$('#finds'),fresh=document.createElement('div');fresh.innerHTML=html;
const names=root=>[...root.querySelectorAll('tr.find')].map(row=>row.dataset.find+row.textContent).sort().join();
if(names(fresh)===names(place))return;
const before=list()[chosen],focused=before&&before===document.activeElement;fill(place,html);
chosen=before?list().findIndex(row=>row.dataset.find===before.dataset.find):-1;const row=list()[chosen];if(!row)return;
row.classList.add('here');if(focused)row.focus({preventScroll:true})}
async function open_(name){const box=$('#find');$('#find-content').textContent='\\u2026';if(!box.open)box.showModal();
const answer=await fetch('find/'+encodeURIComponent(name)),text=await answer.text(),place=$('#find-content');
if(answer.ok)place.innerHTML=text;else place.textContent=text; // a refusal is plain text and repeats what was asked
equip(box);box.scrollTop=0;history.replaceState(null,'','#'+name)}
function rows(){document.querySelectorAll('tr.find:not([data-ready])').forEach(row=>{row.dataset.ready='1';
row.tabIndex=0;row.onclick=()=>{chosen=list().indexOf(row);open_(row.dataset.find)}})}
function step(by){const box=$('#find');choose(chosen+by);if(box&&box.open&&list()[chosen])
open_(list()[chosen].dataset.find)}
document.addEventListener('keydown',event=>{if(event.ctrlKey||event.metaKey||event.altKey)return;
if(/INPUT|SELECT|TEXTAREA/.test(event.target.tagName)){if(event.key==='Escape')event.target.blur();return}
const box=$('#find'),key=event.key;if(key==='j')step(1);else if(key==='k')step(-1);
else if(key==='Enter'&&event.target.classList.contains('find')){event.preventDefault();
open_(event.target.dataset.find)}
else if(key==='/'){const field=$('input.filter');if(field){event.preventDefault();field.focus()}}
else if(key==='d')turn();else if(key==='p'&&may&&!box.open)order(paused?'resume':'pause');
else if(key==='?')$('#help').showModal();else if(key==='r')location.href='/'});
const on=(query,event,run)=>{const place=$(query);if(place)place.addEventListener(event,run)};
on('#pause','click',()=>order(paused?'resume':'pause'));on('#stop','click',()=>order('stop'));
on('#look','click',turn);on('#keys','click',()=>$('#help').showModal());
on('#budget','submit',event=>{event.preventDefault();order('budget','',parseInt(event.target.number.value)||0)});
on('#scorer','submit',event=>{event.preventDefault();order(event.target.role_.value,event.target.model.value)});
for(const box of document.querySelectorAll('dialog')){box.addEventListener('click',event=>{
if(event.target===box)box.close()});on('#'+box.id+' .close','click',()=>box.close());
box.addEventListener('close',()=>history.replaceState(null,'',location.pathname))}
rows();
if(here){const stream=new EventSource('events');stream.onmessage=event=>figures(JSON.parse(event.data));
stream.addEventListener('finds',event=>told(JSON.parse(event.data)));
stream.onerror=()=>{const state=$('.state');
state.textContent='connection lost';state.dataset.state='lost'};
if(location.hash.length>1)open_(location.hash.slice(1))}
"""
)
