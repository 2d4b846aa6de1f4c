"""The script of tables, in the report and the dashboard: sort by a click on a head, filter by words."""

TABLES = """
function value(row,at){const cell=row.cells[at];const text=cell?cell.textContent.trim():'';
return /^[+-]?\\d[\\d.]*(e[+-]\\d+)?(?![\\w.])/.test(text)?parseFloat(text):text.toLowerCase()}
function sort(head){const table=head.closest('table'),at=[...head.parentNode.children].indexOf(head);
const down=head.getAttribute('aria-sort')==='ascending';
for(const other of head.parentNode.children)other.removeAttribute('aria-sort');
head.setAttribute('aria-sort',down?'descending':'ascending');
const rows=[...table.tBodies[0].rows];rows.sort((a,b)=>{const x=value(a,at),y=value(b,at);
const order=typeof x===typeof y?(x<y?-1:x>y?1:0):(typeof x==='number'?-1:1);return down?-order:order});
table.tBodies[0].append(...rows)}
function equip(root){for(const table of root.querySelectorAll('table.sorts:not([data-ready])')){
table.dataset.ready='1';for(const head of table.tHead.rows[0].cells){if(!head.textContent)continue;
head.dataset.sorts='1';head.tabIndex=0;head.onclick=()=>sort(head);
head.onkeydown=(event)=>{if(event.key==='Enter'||event.key===' '){event.preventDefault();sort(head)}}}
if(table.tBodies[0].rows.length<6)continue;const field=document.createElement('input');field.className='filter';
field.type='search';field.placeholder='filter rows';field.setAttribute('aria-label','filter rows');
field.oninput=()=>{const words=field.value.toLowerCase().split(/\\s+/);for(const row of table.tBodies[0].rows){
const text=row.textContent.toLowerCase();row.hidden=!words.every(word=>text.includes(word))}};
table.closest('.scroll').before(field)}}
equip(document);
"""
